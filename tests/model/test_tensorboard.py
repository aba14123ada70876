"""The curves that bc-train writes for TensorBoard, read back by TensorBoard's own reader."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from model import RunError
from model.runs.history import read_history
from model.training.tensorboard import TensorBoard
from tests.helpers.disk import files_of_at_most
from tests.helpers.histories import epoch_line, step_lines, write_lines, write_run


def train(
    run: Path, epochs: Sequence[int], board: TensorBoard, *, stop_after_step: int = 3, **changed: Any
) -> None:
    """Write and tell what a training of these epochs does; the last one may be stopped within."""
    run.mkdir(exist_ok=True)
    for number in epochs:
        steps = step_lines(number)[: stop_after_step if number == epochs[-1] else None]
        for line in steps:
            write_lines(run / "steps.jsonl", [line])
            board.step(read_history(run)[0].steps[-1])
        if len(steps) == 3:
            write_lines(run / "metrics.jsonl", [epoch_line(number, **changed)])
            board.epoch(read_history(run)[0].epochs[-1])


def written(run: Path) -> EventAccumulator:
    return EventAccumulator(str(run / "tensorboard")).Reload()


def points(run: Path, tag: str) -> list[tuple[int, float]]:
    return [(event.step, event.value) for event in written(run).Scalars(tag)]


def near(expected: Sequence[tuple[int, float]]) -> list[Any]:
    """TensorBoard keeps 32 bits of a number."""
    return [(at, pytest.approx(value, rel=1e-6)) for at, value in expected]


def in_the_files(run: Path, name: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run / name).read_text().splitlines()]


def test_every_step_and_epoch_is_a_point_over_the_samples_learnt(tmp_path: Path) -> None:
    run, board = tmp_path / "first", TensorBoard(tmp_path / "first")
    train(run, [1, 2], board)
    board.close()
    steps, epochs = in_the_files(run, "steps.jsonl"), in_the_files(run, "metrics.jsonl")
    assert points(run, "loss/steps") == near([(line["samples"], line["training_loss"]) for line in steps])
    assert points(run, "samples_per_s") == near([(line["samples"], line["samples_per_s"]) for line in steps])
    ends = [25 * 256, 50 * 256]
    for tag, values in {
        "epoch": [1, 2],
        "loss/training": [line["training_loss"] for line in epochs],
        "loss/validation": [line["validation_loss"] for line in epochs],
        "rmse_deg/balanced": [line["balanced_rmse_deg"] for line in epochs],
        "rmse_deg/network": [line["validation"]["rmse_deg"] for line in epochs],
        "turning_mae_deg/mean": [line["mean"]["turning_mae_deg"] for line in epochs],
        "mae_deg/zero": [line["zero"]["mae_deg"] for line in epochs],
        "correlation/network": [line["validation"]["correlation"] for line in epochs],
    }.items():
        assert points(run, tag) == near(list(zip(ends, values, strict=True))), tag
    assert "correlation/zero" not in written(run).Tags()["scalars"]  # null: a constant has none


def test_a_resumed_training_has_every_point_once(tmp_path: Path) -> None:
    """It was killed within epoch 3, after it had been told of a step; it goes on from the end of epoch 2."""
    run, killed = tmp_path / "first", TensorBoard(tmp_path / "first")
    train(run, [1, 2, 3], killed, stop_after_step=2)
    killed.close()
    kept = [line for line in in_the_files(run, "steps.jsonl") if line["epoch"] < 3]
    (run / "steps.jsonl").unlink()
    write_lines(run / "steps.jsonl", kept)
    resumed = TensorBoard(run)
    train(run, [3, 4], resumed)
    resumed.close()
    at = [25 * 256 * epoch - rest for epoch in range(1, 5) for rest in (15 * 256, 5 * 256, 0)]
    assert [samples for samples, _ in points(run, "loss/steps")] == at
    assert [value for _, value in points(run, "epoch")] == [1, 2, 3, 4]


def test_asked_for_when_a_training_is_resumed_it_gets_what_was_before(tmp_path: Path) -> None:
    run = write_run(tmp_path / "first", 2)
    board = TensorBoard(run)
    write_lines(run / "metrics.jsonl", [epoch_line(3)])
    write_lines(run / "steps.jsonl", step_lines(3))
    board.epoch(read_history(run)[0].epochs[-1])  # it was stopped after the last step of epoch 3
    board.close()
    assert points(run, "epoch") == near([(25 * 256, 1), (50 * 256, 2), (75 * 256, 3)])
    assert len(points(run, "loss/steps")) == 9


def test_without_held_out_frames_there_is_the_loss_alone(tmp_path: Path) -> None:
    run, board = tmp_path / "first", TensorBoard(tmp_path / "first")
    train(run, [1], board, frames=0)
    board.close()
    assert set(written(run).Tags()["scalars"]) == {"epoch", "loss/training", "loss/steps", "samples_per_s"}


def test_a_full_disk_is_an_error_and_what_was_written_stays(tmp_path: Path) -> None:
    run, steps = tmp_path / "first", read_history(write_run(tmp_path / "whole", 1))[0].steps
    board = TensorBoard(run)
    train(run, [1], board, stop_after_step=1)
    (file,) = (run / "tensorboard").iterdir()
    with files_of_at_most(file.stat().st_size + 20):
        with pytest.raises(RunError, match="cannot be written"):
            board.step(steps[1])
        board.close()
    assert [at for at, _ in points(run, "loss/steps")] == [steps[0].samples]
