"""The frames held out at which a network is worst after each epoch: found, and kept in the run."""

from __future__ import annotations

import base64
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from common.car import Camera
from dataset import Samples, decode, preprocess
from model import Epoch, train
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


def test_of_a_very_long_training_the_last_epochs_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`read_history` takes no file of any size."""
    monkeypatch.setattr("model.training.run_writer.MAX_WORST_BYTES", 10_000)
    config = replace(SMALL, epochs=6, batch=16)
    train(toy_index(tmp_path), tmp_path / "run", config, show_progress=False)
    history, skipped = read_history(tmp_path / "run")
    assert len(skipped) == 0
    assert [epoch.epoch for epoch in history.epochs] == list(range(1, 7))
    kept = [worst.epoch for worst in history.worst]
    assert kept == list(range(kept[0], 7))
    assert 1 < kept[0] < 6
    assert (tmp_path / "run" / "worst.jsonl").stat().st_size < 2 * 10_000


def test_lines_that_no_training_writes_are_skipped_and_named(folder: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    for name in ("metrics.jsonl", "steps.jsonl"):
        (run / name).write_bytes((folder / "run" / name).read_bytes())
    good = lines(folder / "run")
    frame = good[1]["frames"][0]
    _, bomb = cv2.imencode(".png", np.zeros((5000, 5000), np.uint8))  # few bytes, many pixels
    wrong = (
        {"epoch": 2, "frames": [{**frame, "jpeg": base64.b64encode(bomb.tobytes()).decode()}]},
        {"epoch": 2, "frames": [{**frame, "jpeg": "no base64"}]},
        {"epoch": 2, "frames": [{**frame, "jpeg": "bm8gcGljdHVyZQ=="}]},
        {"epoch": 2, "frames": [{**frame, "row": -1}]},
        {"epoch": 2, "frames": [{**frame, "error_deg": None}]},
        {"epoch": 2, "frames": [{**frame, "session": 7}]},
        {"epoch": 2, "frames": [frame] * 7},
        {"epoch": 2, "frames": 3},
        {"epoch": 1, "frames": []},
    )
    (run / "worst.jsonl").write_text("".join(json.dumps(line) + "\n" for line in (good[0], *wrong, good[1])))
    history, skipped = read_history(run)
    assert [worst.epoch for worst in history.worst] == [1, 2]
    assert [name for _, name in skipped] == [f"worst.jsonl line {2 + number}" for number in range(len(wrong))]


def test_a_run_of_before_is_shown_without(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "metrics.jsonl").write_bytes((folder / "run" / "metrics.jsonl").read_bytes())
    history, _ = read_history(tmp_path / "run")
    assert history.worst == ()
    assert all(isinstance(epoch, Epoch) for epoch in history.epochs)
