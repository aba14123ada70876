"""The frames held out at which a network is worst after each epoch: found, and kept in the run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from common.car import Camera
from dataset import Samples, decode, preprocess
from model import train
from model.network.choice import built_in
from model.runs.history import read_history
from tests.helpers.logs import START_NS, STEP_NS
from tests.helpers.toy import SMALL, STEERING, road, toy_index

CONFIG = replace(SMALL, epochs=3, batch=16)  # what is worst needs no good network
SEEN = built_in("small", {}).picture


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`run`, which was trained on `index`."""
    folder = tmp_path_factory.mktemp("worst")
    train(toy_index(folder), folder / "run", CONFIG, show_progress=False)
    return folder


def held_out(folder: Path) -> list[int]:
    samples = Samples(folder / "index")
    samples.close()
    return [row["row"] for row in samples.table.to_pylist() if row["split"] == "validation"]


def lines(run: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run / "worst.jsonl").read_text().splitlines()]


def test_each_epoch_has_its_worst_frames_of_those_held_out(folder: Path) -> None:
    for line, epoch in zip(lines(folder / "run"), read_history(folder / "run")[0].epochs, strict=True):
        assert line["epoch"] == epoch.epoch
        errors = [abs(frame["error_deg"]) for frame in line["frames"]]
        assert errors == sorted(errors, reverse=True)
        assert errors[0] >= epoch.measures.network.rmse_deg
        for frame in line["frames"]:
            assert frame["row"] in held_out(folder)
            assert frame["recorded_deg"] == pytest.approx(25 * STEERING[frame["row"]])
            assert frame["log_time_ns"] == START_NS + frame["row"] * STEP_NS


def test_the_pictures_are_what_the_network_saw_there(folder: Path) -> None:
    history, skipped = read_history(folder / "run")
    assert len(skipped) == 0
    assert len(history.worst) == CONFIG.epochs
    for worst in history.worst:
        assert worst.jpegs
        for frame, jpeg in zip(worst.frames, worst.jpegs, strict=True):
            seen = preprocess(decode(road("center", frame.row)), SEEN)
            assert np.abs(decode(jpeg).astype(int) - seen).mean() < 3  # a JPEG of it


def test_a_picture_that_does_not_decode_moves_no_other_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = held_out(toy_index(tmp_path).parent)[0]

    def picture(camera: Camera, row: int) -> bytes:
        return b"no picture" if row == broken else road(camera, row)

    (tmp_path / "toy.mcap").unlink()
    monkeypatch.setattr("tests.helpers.toy.road", picture)
    train(toy_index(tmp_path), tmp_path / "run", CONFIG, show_progress=False)
    worst_of_epochs = read_history(tmp_path / "run")[0].worst
    assert [len(worst.frames) > 0 for worst in worst_of_epochs] == [True] * CONFIG.epochs
    for worst in worst_of_epochs:
        for frame, jpeg in zip(worst.frames, worst.jpegs, strict=True):
            assert frame.row != broken
            seen = preprocess(decode(road("center", frame.row)), SEEN)
            assert np.abs(decode(jpeg).astype(int) - seen).mean() < 3


def test_a_run_that_goes_on_has_each_epoch_once(tmp_path: Path) -> None:
    index = toy_index(tmp_path)
    for epochs in (1, 2):
        config = replace(SMALL, epochs=epochs, batch=16)
        train(index, tmp_path / "run", config, resume=epochs > 1, show_progress=False)
    assert [line["epoch"] for line in lines(tmp_path / "run")] == [1, 2]
