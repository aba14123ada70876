"""What bc-train writes of a training, line by line, as the tests of its curves need it."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

BATCH = 256


def epoch_line(epoch: int, *, is_best: bool = True, frames: int = 100, **changed: Any) -> dict[str, Any]:
    """An epoch that gets better with its number; with `frames` 0, one of a run that holds nothing out."""
    known = 1.0 if frames else None

    def errors(rmse_deg: float) -> dict[str, float | None]:
        return {
            "mae_deg": known and rmse_deg / 2,
            "rmse_deg": known and rmse_deg,
            "turning_mae_deg": known and rmse_deg * 2,
            "correlation": known and 1 / rmse_deg,
        }

    network_deg = 6.0 / epoch
    bins = [
        {
            "bin": number,
            "low": -1 + 0.08 * number,
            "high": -1 + 0.08 * (number + 1),
            "frames": count,
            "mae_deg": network_deg / 2,
            "rmse_deg": network_deg * factor,
            "bias_deg": -0.5,
        }
        for number, count, factor in ((3, 10, 3.0), (12, frames - 10, 1.0))
    ]
    return {
        "epoch": epoch,
        "training_loss": 0.2 / epoch,
        "validation_loss": known and 0.3 / epoch,
        "validation": errors(network_deg),
        "zero": {**errors(5.0), "correlation": None},
        "mean": {**errors(4.5), "correlation": None},
        "balanced_rmse_deg": known and network_deg * 5**0.5,
        "bins": bins if frames else [],
        "is_best": is_best,
        "seconds": 2.0,
        "samples_per_s": 400.0,
        **changed,
    }


def step_lines(epoch: int) -> list[dict[str, Any]]:
    """Those of an epoch of 25 batches."""
    return [
        {
            "epoch": epoch,
            "batch": batch,
            "batches": 25,
            "samples": BATCH * (25 * (epoch - 1) + batch),
            "training_loss": 0.2 / epoch + 0.01 * batch,
            "samples_per_s": 400.0 + batch,
        }
        for batch in (10, 20, 25)
    ]


def write_lines(path: Path, lines: Iterable[dict[str, Any]]) -> None:
    """Add them as a training does."""
    with path.open("a", encoding="utf-8") as stream:
        stream.writelines(json.dumps(line) + "\n" for line in lines)


def write_run(run: Path, epochs: int, **changed: Any) -> Path:
    """A run's folder with so many epochs, as far as its curves are concerned."""
    run.mkdir(parents=True, exist_ok=True)
    for epoch in range(1, epochs + 1):
        write_lines(run / "steps.jsonl", step_lines(epoch))
        write_lines(run / "metrics.jsonl", [epoch_line(epoch, **changed)])
    return run
