"""`--keep`: which epoch's weights are kept, and drive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from model import Epoch, train
from model.cli import main
from model.config import Keep
from tests.helpers.toy import SMALL
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
