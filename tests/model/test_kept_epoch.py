"""`--keep`: which epoch's weights are kept, and drive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file

from model import Epoch, train
from model.cli import main
from model.config import Keep
from model.network.pilotnet import SteeringNetwork
from model.training.loop import AveragedWeights
from tests.helpers.toy import SMALL, toy_index
from tests.helpers.udacity import call


@pytest.mark.parametrize("seed", [3, 7])  # of the one, driving-error is least in another epoch; of the other, rmse
@pytest.mark.parametrize("keep", ["driving-error", "balanced-rmse", "rmse", "last"])
def test_the_epoch_that_is_kept_has_the_least_of_what_was_asked_for(
    index: Path, tmp_path: Path, keep: Keep, seed: int
) -> None:
    errors: dict[str, Callable[[Epoch], float]] = {
        "driving-error": lambda epoch: (
            epoch.measures.balanced_rmse_deg / epoch.measures.mean_balanced_rmse_deg
            - epoch.measures.network.correlation
        ),
        "balanced-rmse": lambda epoch: epoch.measures.balanced_rmse_deg,
        "rmse": lambda epoch: epoch.measures.network.rmse_deg,
        "last": lambda epoch: -epoch.epoch,
    }
    error = errors[keep]
    config = replace(SMALL, epochs=6, rate=2e-3, seed=seed, keep=keep)  # so fast that it gets worse again
    trained = train(index, tmp_path / "run", config)
    least: Epoch = min(trained.epochs, key=error)
    assert trained.best_epoch == least.epoch
    assert [epoch.is_best for epoch in trained.epochs] == [
        error(epoch) < min((error(before) for before in trained.epochs[:number]), default=1e9)
        for number, epoch in enumerate(trained.epochs)
    ]


@pytest.mark.parametrize(("keep", "marked"), [("last", 0), ("driving-error", 1)])
def test_an_epoch_is_marked_only_if_one_is_chosen(
    index: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], keep: str, marked: int
) -> None:
    flags = ["--network", "small", "--epochs", 1, "--batch", 6, "--threads", 1, "--keep", keep]
    assert call(main, "--name", "run", "--index", index, "--runs", tmp_path, *flags) == 0
    assert capsys.readouterr().out.count("samples/s, kept") == marked


def bias_after(steps: list[float], average_steps: int) -> float:
    """The mean of a weight that takes these values, one a step."""
    network = SteeringNetwork()
    averaged = AveragedWeights(network, average_steps)
    averaged.begin(network)
    for number, value in enumerate(steps, 1):
        torch.nn.init.constant_(network.head[-1].bias, value)  # type: ignore[arg-type]
        averaged.update(network, number)
    return float(averaged.network.state_dict()["head.11.bias"])


def test_it_is_the_exponential_mean() -> None:
    values = np.random.default_rng(0).normal(0, 1, 200).tolist()
    expected = 0.0
    for number, value in enumerate(values, 1):
        share = max(1 / 20, 10 / (10 + number))
        expected += share * (value - expected)
    assert abs(bias_after(values, 20) - expected) < 1e-5


def test_it_is_kept_and_what_is_learnt_is_not_changed_by_it(tmp_path: Path) -> None:
    index = toy_index(tmp_path)
    runs = [tmp_path / name for name in ("latest", "mean")]
    for run, steps in zip(runs, (1, 10), strict=True):
        train(index, run, replace(SMALL, epochs=1, average_steps=steps))
    latest, mean = (load_file(run / "last" / "checkpoint.safetensors") for run in runs)
    assert all((mean[name] == tensor).all() for name, tensor in latest.items())
    kept = load_file(runs[1] / "model.safetensors")
    assert all((kept[name] == mean[f"averaged.{name}"]).all() for name in kept)
    assert any((kept[name] != latest[f"network.{name}"]).any() for name in kept)
