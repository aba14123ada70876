"""The history of a run: all that its files hold, also while they grow, and whoever wrote them."""

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
from model.runs.history import History, parse_epoch, read_history
from model.runs.training_progress import METRICS_FILE, STEPS_FILE, Step
from model.training.run_writer import RunWriter
from tests.helpers.histories import epoch_line, write_lines, write_run
from tests.helpers.logs import START_NS, STEP_NS
from tests.helpers.toy import SMALL, STEERING, road, toy_index


def wrong_epochs() -> list[str]:
    """Lines in place of the second epoch's."""
    good = epoch_line(2)
    no_numbers: list[Any] = [0, -1, 1, 1.5, True, "2", None, 10**40, []]
    no_losses: list[Any] = ["0", [], True, 1e200, 10**400, float("nan")]

    def with_bin(**changed: Any) -> dict[str, Any]:
        return {**good, "bins": [{**good["bins"][0], **changed}]}

    return [
        *("", "oops", "[]", "null", "7", '"text"', "[" * 100_000, " " * 2_000_000 + json.dumps(good)),
        *(json.dumps({name: value for name, value in good.items() if name != gone}) for gone in ("bins", "zero")),
        *(json.dumps({**good, "epoch": number}) for number in no_numbers),
        *(json.dumps({**good, "training_loss": loss}) for loss in no_losses),
        json.dumps(good).replace("0.1", "1e999", 1),
        json.dumps(good).replace("0.1", "9" * 5000, 1),
        json.dumps(with_bin(low=0.5)),
        json.dumps(with_bin(low=None)),
        json.dumps(with_bin(frames=0)),
        json.dumps({**good, "bins": {"a": 1}}),
        json.dumps({**good, "validation": [1, 2]}),
        "\udcff",
    ]


def test_lines_that_no_training_writes_are_named_and_the_others_read(tmp_path: Path) -> None:
    run, wrong = write_run(tmp_path / "first", 1), wrong_epochs()
    with (run / "metrics.jsonl").open("ab") as stream:
        stream.writelines(line.encode("utf-8", "surrogateescape") + b"\n" for line in wrong)
    write_lines(run / "metrics.jsonl", [epoch_line(3)])
    history, skipped = read_history(run)
    assert [epoch.epoch for epoch in history.epochs] == [1, 3]
    assert [name for _, name in skipped] == [f"metrics.jsonl line {2 + i}" for i in range(len(wrong))]
    assert [epoch.training_loss for epoch in history.epochs] == pytest.approx([0.2, 0.2 / 3])


def test_a_last_line_that_a_kill_has_cut_off_is_named(tmp_path: Path) -> None:
    run = write_run(tmp_path / "first", 2)
    data = (run / "metrics.jsonl").read_bytes()
    (run / "metrics.jsonl").write_bytes(data[:-20])
    history, skipped = read_history(run)
    assert len(history.epochs) == 1
    assert list(skipped) == [("lines that were cut off", "metrics.jsonl line 2")]


def test_a_folder_without_a_training_has_no_history(tmp_path: Path) -> None:
    history, skipped = read_history(tmp_path)
    assert history == History((), ())
    assert len(skipped) == 0


def test_of_a_file_that_grows_the_whole_lines_are_read(tmp_path: Path) -> None:
    whole, run = write_run(tmp_path / "whole", 4), tmp_path / "first"
    run.mkdir()
    lines = (whole / "metrics.jsonl").read_bytes().splitlines(keepends=True)
    for count, cut in ((0, 1), (1, 0), (2, 30), (4, 0)):
        (run / "metrics.jsonl").write_bytes(b"".join(lines)[: sum(map(len, lines[:count])) + cut])
        history, skipped = read_history(run)
        assert [epoch.epoch for epoch in history.epochs] == list(range(1, count + 1))
        assert len(skipped) == bool(cut)


def test_a_very_long_history_loses_every_second_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("model.training.run_writer.MAX_HISTORY_BYTES", 20_000)
    writer = RunWriter(tmp_path)
    measured = parse_epoch(json.dumps(epoch_line(1)).encode())
    for number in range(1, 301):
        writer.add_step(Step(number, 1, 1, number, 0.1, 100.0))
        writer.add_epoch(replace(measured, epoch=number, is_best=number == 2), None)
    for name in (METRICS_FILE, STEPS_FILE):
        assert (tmp_path / name).stat().st_size < 22_000
    history, skipped = read_history(tmp_path)
    assert len(skipped) == 0
    assert history.best is not None
    assert history.best.epoch == 2
    assert history.epochs[-1].epoch == history.steps[-1].epoch == 300
    assert history.steps[0].epoch < 150


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
