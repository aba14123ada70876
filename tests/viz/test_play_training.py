"""A run's training in the viewer: all that its files tell, also while they grow, and whoever wrote them.

What a viewer gets is read back from an .rrd file by Rerun's own reader.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil  # type: ignore[import-untyped]  # comes with rerun-sdk
import pytest

from common.locks import lock
from driving import Process, command, environment
from histories import epoch_line, step_lines, write_lines, write_run
from model import RunError
from model.runs.history import HistoryReader, read_history
from model.runs.training_progress import Epoch, Step
from ports import free_ports
from rrd import contents, listening, view_names
from udacity import call
from viz.cli import main
from viz.viewer_process import viewer_program
from waiting import PATIENCE_S, wait_until


def points(rrd: Path, entity: str) -> list[tuple[int, float]]:
    """Where a line has which values."""
    columns = contents(rrd)[entity]
    return [
        (at, value[0]) for at, value in zip(columns["samples"], columns["Scalars:scalars"], strict=True) if value
    ]


def ends(epochs: int) -> list[int]:
    return [25 * 256 * epoch for epoch in range(1, epochs + 1)]


def in_the_files(run: Path, name: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run / name).read_text().splitlines()]


# What is shown


def test_every_curve_has_the_values_of_the_runs_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, rrd = write_run(tmp_path / "first", 3), tmp_path / "first.rrd"
    assert call(main, run, "--save", rrd) == 0
    output = capsys.readouterr()
    assert output.out == f"{rrd}: written\n"
    assert output.err.splitlines()[-1].endswith(f"rerun {rrd}`")
    steps, epochs = in_the_files(run, "steps.jsonl"), in_the_files(run, "metrics.jsonl")
    assert points(rrd, "/loss/steps") == [(line["samples"], line["training_loss"]) for line in steps]
    for entity, values in {
        "/loss/training": [line["training_loss"] for line in epochs],
        "/loss/validation": [line["validation_loss"] for line in epochs],
        "/loss/mean": [(4.5 / 25) ** 2] * 3,
        "/loss/zero": [(5.0 / 25) ** 2] * 3,
        "/rmse_deg/network": [line["validation"]["rmse_deg"] for line in epochs],
        "/rmse_deg/balanced": [line["balanced_rmse_deg"] for line in epochs],
        "/rmse_deg/mean": [4.5] * 3,
        "/turning_mae_deg/network": [line["validation"]["turning_mae_deg"] for line in epochs],
        "/turning_mae_deg/zero": [10.0] * 3,
    }.items():
        found = points(rrd, entity)
        assert [at for at, _ in found] == ends(3), entity
        assert [value for _, value in found] == pytest.approx(values), entity
    assert contents(rrd)["/rmse_deg/network"]["epoch"] == [1, 2, 3]
    assert contents(rrd)["/__properties"]["RecordingInfo:name"] == [["first"]]


def test_the_errors_by_steering_are_bars_of_every_epoch(tmp_path: Path) -> None:
    assert call(main, write_run(tmp_path / "first", 2), "--save", tmp_path / "first.rrd") == 0
    found = contents(tmp_path / "first.rrd")
    for name, expected in (("rmse_deg", [[18.0, 6.0], [9.0, 3.0]]), ("frames", [[10, 90], [10, 90]])):
        bars = found[f"/bins/{name}"]
        assert bars["samples"] == ends(2)
        shown = [list(value[0]["buffer"]) for value in bars["BarChart:values"]]
        assert shown == [pytest.approx(each) for each in expected]
        middles = list(bars["BarChart:abscissa"][0][0]["buffer"])
        assert middles == pytest.approx([-0.72, 0.0], abs=1e-9)


def test_the_best_epochs_so_far_are_marked(tmp_path: Path) -> None:
    run = write_run(tmp_path / "first", 2)
    write_lines(run / "steps.jsonl", step_lines(3))
    write_lines(run / "metrics.jsonl", [epoch_line(3, is_best=False)])
    assert call(main, run, "--save", tmp_path / "first.rrd") == 0
    assert [at for at, _ in points(tmp_path / "first.rrd", "/rmse_deg/best")] == ends(2)


def test_a_target_besides_steering_has_a_view_of_its_own(tmp_path: Path) -> None:
    run = write_run(tmp_path / "first", 0)
    speed = {"target": "speed", "frames": 90, "mae": 1.0, "bias": 0.1, "correlation": 0.9, "mean_rmse": 6.0}
    for epoch in (1, 2):
        write_lines(run / "steps.jsonl", step_lines(epoch))
        write_lines(run / "metrics.jsonl", [epoch_line(epoch, targets=[{**speed, "rmse": 4.0 / epoch}])])
    assert call(main, run, "--save", tmp_path / "first.rrd") == 0
    assert "frames held out: RMSE of speed, mph" in view_names(tmp_path / "first.rrd")
    assert points(tmp_path / "first.rrd", "/speed_rmse/network") == list(zip(ends(2), [4.0, 2.0], strict=True))
    assert points(tmp_path / "first.rrd", "/speed_rmse/mean") == list(zip(ends(2), [6.0, 6.0], strict=True))
    # the loss is a sum, of which the errors of constant steering are a part: they are no limit beside it
    assert "loss: mean squared errors of steering, speed, summed up" in view_names(tmp_path / "first.rrd")
    assert not {"/loss/mean", "/loss/zero"} & contents(tmp_path / "first.rrd").keys()


def test_the_layout_has_views_of_errors_where_something_was_held_out(tmp_path: Path) -> None:
    assert call(main, write_run(tmp_path / "a", 1), "--save", tmp_path / "a.rrd") == 0
    assert call(main, write_run(tmp_path / "b", 1, frames=0), "--save", tmp_path / "b.rrd") == 0
    loss = "loss: mean squared error of steering -1 .. 1"
    assert view_names(tmp_path / "b.rrd") == {loss}
    assert loss in view_names(tmp_path / "a.rrd")
    assert len(view_names(tmp_path / "a.rrd")) == 5 + 6 + 1  # with the worst frames, and those in words
    assert "/rmse_deg/network" in contents(tmp_path / "a.rrd")
    assert not {"/rmse_deg/mean", "/bins/frames"} & {
        entity for entity, columns in contents(tmp_path / "b.rrd").items() if "samples" in columns
    }


def test_a_training_that_is_still_in_its_first_epoch_is_shown(tmp_path: Path) -> None:
    (tmp_path / "first").mkdir()
    write_lines(tmp_path / "first" / "steps.jsonl", step_lines(1)[:1])
    assert call(main, tmp_path / "first", "--save", tmp_path / "first.rrd") == 0
    assert [at for at, _ in points(tmp_path / "first.rrd", "/loss/steps")] == [2560]


def test_it_is_shown_without_loading_torch(tmp_path: Path) -> None:
    code = "import sys, viz.training_curves, model.runs.history; print('torch' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment(), capture_output=True, text=True, check=True
    )
    assert done.stdout == "False\n"


# Files that somebody else has written


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


def test_lines_that_no_training_writes_are_named_and_the_others_are_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, wrong = write_run(tmp_path / "first", 1), wrong_epochs()
    with (run / "metrics.jsonl").open("ab") as stream:
        stream.writelines(line.encode("utf-8", "surrogateescape") + b"\n" for line in wrong)
    write_lines(run / "metrics.jsonl", [epoch_line(3)])
    history, skipped = read_history(run)
    assert [epoch.epoch for epoch in history.epochs] == [1, 3]
    assert [name for _, name in skipped] == [f"metrics.jsonl line {2 + i}" for i in range(len(wrong))]
    assert call(main, run, "--save", tmp_path / "first.rrd") == 3
    assert (
        f"skipped lines that no training writes: {len(wrong)} (metrics.jsonl line 2, " in capsys.readouterr().err
    )
    assert [value for _, value in points(tmp_path / "first.rrd", "/loss/training")] == pytest.approx(
        [0.2, 0.2 / 3]
    )


def test_fields_that_nobody_reads_may_hold_anything(tmp_path: Path) -> None:
    """Those of a later version, or of somebody else's tools."""
    run = write_run(tmp_path / "first", 1)
    before, _ = read_history(run)
    anything: list[Any] = [10**40, 1e200, float("nan"), None, True, "\ud800", [], {"deep": -(10**400)}]
    for number, value in enumerate(anything, 2):
        good, step = epoch_line(number), step_lines(number)[0]
        changed = {name: {**good[name], "balanced_rmse_deg": value} for name in ("validation", "zero")}
        bins = [{**part, "later": value} for part in good["bins"]]
        write_lines(
            run / "metrics.jsonl", [{**good, **changed, "bins": bins, "balanced_rmse_deg": value, "x": value}]
        )
        write_lines(run / "steps.jsonl", [{**step, "later": value}])
    history, skipped = read_history(run)
    assert list(skipped) == []
    assert [epoch.epoch for epoch in history.epochs] == list(range(1, 2 + len(anything)))
    assert len(history.steps) == len(before.steps) + len(anything)


def test_a_last_line_that_a_kill_has_cut_off_is_named(tmp_path: Path) -> None:
    run = write_run(tmp_path / "first", 2)
    data = (run / "metrics.jsonl").read_bytes()
    (run / "metrics.jsonl").write_bytes(data[:-20])
    history, skipped = read_history(run)
    assert len(history.epochs) == 1
    assert list(skipped) == [("lines that were cut off", "metrics.jsonl line 2")]


@pytest.mark.parametrize("seed", range(3))
def test_damaged_files_are_read_as_far_as_they_make_sense(tmp_path: Path, seed: int) -> None:
    run, chance = write_run(tmp_path / "first", 3), random.Random(seed)
    whole = (run / "metrics.jsonl").read_bytes()
    for _ in range(200):
        damaged = bytearray(whole)
        for _ in range(3):
            damaged[chance.randrange(len(damaged))] = chance.choice(b'0123456789"{}[],:.-e\n\0\xff')
        (run / "metrics.jsonl").write_bytes(damaged)
        history, skipped = read_history(run)
        assert len(history.epochs) + len(skipped) >= 1
        assert all(epoch.epoch > 0 for epoch in history.epochs)


@pytest.mark.parametrize("name", ["metrics.jsonl", "steps.jsonl"])
def test_a_link_a_folder_or_a_pipe_is_an_error_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    elsewhere = write_run(tmp_path / "elsewhere", 1)
    kinds: dict[str, Callable[[Path], object]] = {
        "link": lambda path: path.symlink_to(elsewhere / name),
        "folder": Path.mkdir,
        "pipe": os.mkfifo,
    }
    for kind, make in kinds.items():
        run = write_run(tmp_path / kind, 1)
        (run / name).unlink()
        make(run / name)
        assert call(main, run, "--save", tmp_path / "a.rrd") == 1
        (said,) = capsys.readouterr().err.splitlines()
        assert said.startswith(f"bc-play: {run / name}: ")
        assert not (tmp_path / "a.rrd").exists()


def test_a_file_that_is_all_hole_is_not_read(tmp_path: Path) -> None:
    run = write_run(tmp_path / "first", 1)
    os.truncate(run / "steps.jsonl", 10**11)
    with pytest.raises(RunError, match=r"steps\.jsonl: larger than"):
        read_history(run)


def test_a_folder_without_a_training_is_an_error_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(main, tmp_path, "--save", tmp_path / "a.rrd") == 1
    assert capsys.readouterr().err.splitlines() == [
        f"bc-play: {tmp_path}: no training in it (metrics.jsonl is missing); `bc-train` makes a run"
    ]


def test_of_a_folder_of_logs_or_runs_those_are_named_and_no_viewer_opens(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, run, empty = tmp_path / "lake.mcap", write_run(tmp_path / "first", 1), tmp_path / "other"
    log.touch()
    empty.mkdir()
    for folder, flags, says in (
        (tmp_path, (), f"give one of them, {run}, {log}"),
        (tmp_path, ("--follow",), f"give one of them, {run}, {log}"),
        (empty, (), "no training in it"),
    ):
        assert call(main, folder, "--web", *flags) == 1
        said = capsys.readouterr()
        assert says in said.err
        assert said.err.count("\n") == 1
        assert said.out == ""  # the address of a page


# While it is trained


def test_however_the_files_grow_every_line_is_read_once(tmp_path: Path) -> None:
    whole, run, chance = write_run(tmp_path / "whole", 4), tmp_path / "first", random.Random(0)
    run.mkdir()
    reader = HistoryReader(run)
    epochs: list[Epoch] = []
    steps: list[Step] = []
    for name in ("steps.jsonl", "metrics.jsonl"):
        data = (whole / name).read_bytes()
        cuts = sorted(chance.sample(range(len(data)), 20))
        for start, end in zip([0, *cuts], [*cuts, len(data)], strict=True):
            with (run / name).open("ab") as stream:
                stream.write(data[start:end])
            history, is_replaced = reader.read()
            assert not is_replaced
            epochs += history.epochs
            steps += history.steps
    expected, _ = read_history(whole)
    assert (tuple(epochs), tuple(steps)) == (expected.epochs, expected.steps)
    assert len(reader.skipped) == 0


def test_files_that_a_resumed_training_has_replaced_are_read_anew(tmp_path: Path) -> None:
    run = write_run(tmp_path / "first", 3)
    reader = HistoryReader(run)
    assert len(reader.read()[0].epochs) == 3
    for name, kept in (("metrics.jsonl", 2), ("steps.jsonl", 7)):
        lines = (run / name).read_bytes().splitlines(keepends=True)[:kept]
        (run / "new").write_bytes(b"".join(lines))
        (run / "new").replace(run / name)
    history, is_replaced = reader.read()
    assert is_replaced
    assert [epoch.epoch for epoch in history.epochs] == [1, 2]
    assert len(history.steps) == 7
    write_lines(run / "metrics.jsonl", [epoch_line(3)])
    history, is_replaced = reader.read()
    assert ([epoch.epoch for epoch in history.epochs], is_replaced) == ([3], False)


def test_a_run_that_is_gone_is_an_error_and_not_waited_for(tmp_path: Path) -> None:
    run = write_run(tmp_path / "first", 1)
    reader = HistoryReader(run)
    reader.read()
    run.rename(tmp_path / "other")
    with pytest.raises(RunError, match="first: "):
        reader.read()


not_on_windows = pytest.mark.skipif(sys.platform == "win32", reason="an open file cannot be replaced there")


@not_on_windows
def test_saving_a_run_that_is_trained_waits_until_it_is(tmp_path: Path) -> None:
    run, rrd = write_run(tmp_path / "first", 1), tmp_path / "first.rrd"
    (run / "last").mkdir()
    with (run / "last" / ".lock").open("ab") as training:
        lock(training)
        with Process(command("bc-play", run, "--follow", "--save", rrd)) as play:
            with pytest.raises(subprocess.TimeoutExpired):
                play.popen.wait(1.0)
            write_lines(run / "steps.jsonl", step_lines(2))
            write_lines(run / "metrics.jsonl", [epoch_line(2)])
            training.close()
            assert play.join() == 0, play.stderr
    assert [at for at, _ in points(rrd, "/loss/training")] == ends(2)


def received(port: int, rrd: Path) -> subprocess.Popen[bytes]:
    """Another client of the viewer, which writes what the viewer has, until the viewer ends."""
    address = f"rerun+http://127.0.0.1:{port}/proxy"
    line = [str(viewer_program()), address, "--save", str(rrd), "--bind", "127.0.0.1", "--port", "auto"]
    return subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment())


class Following(Process):
    """`bc-play --follow --web` on free ports."""

    def __init__(self, run: Path) -> None:
        self.web_port, self.port = free_ports(2)
        flags = ("--follow", "--web", "--web-port", self.web_port, "--port", self.port)
        super().__init__(command("bc-play", run, *flags))

    def viewer(self) -> psutil.Process:
        """Once it listens."""
        self.wait_for("open that address in a browser")
        children = psutil.Process(self.popen.pid).children
        wait_until(lambda: any(set(listening(child)) == {self.web_port, self.port} for child in children()))
        (viewer,) = children()
        return viewer


def has_arrived(rrd: Path, entity: str, count: int) -> bool:
    """Whether so many points are in a file that is still being written."""
    with contextlib.suppress(RuntimeError, ValueError, KeyError), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it has no end yet
        return len(points(rrd, entity)) == count
    return False


@not_on_windows
def test_a_run_is_shown_before_it_is_there_and_as_it_grows(tmp_path: Path) -> None:
    run, rrd = tmp_path / "first", tmp_path / "got.rrd"
    with Following(run) as play, contextlib.ExitStack() as stack:
        viewer = play.viewer()
        stack.callback(lambda: viewer.is_running() and viewer.kill())
        play.wait_for("waits until .*first is trained")
        client = stack.enter_context(received(play.port, rrd))
        stack.callback(client.kill)
        write_run(run, 1)
        wait_until(lambda: has_arrived(rrd, "/loss/training", 1))
        write_lines(run / "steps.jsonl", step_lines(2))
        write_lines(run / "metrics.jsonl", [{"epoch": "two"}, epoch_line(2)])
        wait_until(lambda: has_arrived(rrd, "/turning_mae_deg/zero", 2))
        assert play.end(signal.SIGINT) == 130
        client.wait(PATIENCE_S)
        assert not viewer.is_running()
    assert [at for at, _ in points(rrd, "/loss/training")] == ends(2)
    assert len(points(rrd, "/loss/steps")) == 6
    assert any("skipped lines that no training writes: 1 (metrics.jsonl line 2)" in said for said in play.stderr)
    assert not any("Traceback" in said for said in play.stderr), play.stderr
