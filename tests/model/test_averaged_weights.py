"""`--average-steps`: the weights that are kept are the mean of those after the last steps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from safetensors.numpy import load_file

from model import train
from model.network.original import SteeringNetwork
from model.training.averaged_weights import AveragedWeights
from tests.helpers.toy import SMALL, toy_index


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
