"""`bc-eval RUN` on recorded frames: its numbers are those that anybody computes from the files, and it says when
the run has learnt from what it is measured by."""

from __future__ import annotations

import json
import math
import re
import shlex
import shutil
import statistics
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from safetensors.numpy import load_file, save_file

from common.car import Camera
from dataset import IndexConfig, build_index, decode
from drive.evaluation.eval_cli import main
from drive.evaluation.eval_report import print_evaluation
from model import load_pilot, train
from model.evaluation.evaluate import Evaluation, evaluate, evaluate_sessions
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from tests.helpers.logs import START_NS, not_a_picture, plain_read, read_messages, write_log
from tests.helpers.toy import SMALL, STEERING, road
from tests.helpers.udacity import call, encode

STEP_NS = 300_000_000
SPLIT = IndexConfig(flip=False, max_uses=1, block_s=1.2, gap_s=0.3, validation_share=0.4)
LEFT = [round(-0.5 - 0.01 * row, 3) for row in range(30)]  # of the second session

Row = dict[str, Any]


def left_road(camera: Camera, row: int) -> bytes:
    """A grey post where the steering of the second session is."""
    picture = np.zeros((160, 320, 3), np.uint8)
    middle = round(160 + 140 * LEFT[row])
    picture[:, middle - 20 : middle + 20] = 150 + row
    return encode(picture)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sessions (a, b), their index, and runs/toy, which was trained on it; and a third session (new)."""
    folder = tmp_path_factory.mktemp("evaluated")
    logs = [
        write_log(folder / "sessions" / "a.mcap", STEERING, road, cameras=["center"], step_ns=STEP_NS),
        write_log(folder / "sessions" / "b.mcap", LEFT, left_road, cameras=["center", "left"], step_ns=STEP_NS),
    ]
    index = build_index(logs, folder / "index", SPLIT).path
    config = replace(SMALL, epochs=2, batch=8)
    train(index, folder / "runs" / "toy", config, show_progress=False)
    write_log(folder / "sessions" / "new.mcap", STEERING[::-1], road, step_ns=STEP_NS + 1)
    return folder


@pytest.fixture
def cwd(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same folder, worked in as a user does, in a terminal of 80 columns."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "80")
    return folder


@pytest.fixture(scope="module")
def held_out(folder: Path) -> list[Row]:
    """The frames of validation, from the index's parquet and the logs' bytes: where they are, how they were
    driven, what the network says."""
    pilot = load_pilot(folder / "runs" / "toy", "float32")
    frames = []
    for session in ("a", "b"):
        for row in pq.read_table(folder / "index" / "frames" / f"{session}.parquet").to_pylist():
            if row["camera"] == "center" and row["split"] == "validation":
                jpeg = plain_read(folder / "sessions" / f"{session}.mcap", row["offset"], row["length"])
                row["predicted_deg"] = 25 * pilot.predict(pilot.crop(decode(jpeg)))
                row["recorded_deg"] = 25 * (STEERING if session == "a" else LEFT)[row["row"]]
                row["off_deg"] = row["predicted_deg"] - row["recorded_deg"]
                frames.append(row)
    return frames


@pytest.fixture(scope="module")
def evaluation(folder: Path) -> Evaluation:
    return evaluate(folder / "runs" / "toy", folder / "index")


def rmse(off: list[float]) -> float:
    return math.sqrt(statistics.fmean(value * value for value in off))


def off_deg(rows: list[Row]) -> list[float]:
    return [row["off_deg"] for row in rows]


# The numbers


def test_the_measures_are_those_of_the_held_out_pictures(evaluation: Evaluation, held_out: list[Row]) -> None:
    assert {row["session"] for row in held_out} == {"a", "b"}
    recorded = [row["recorded_deg"] for row in held_out]
    network = evaluation.measures.network
    assert evaluation.measures.frames == len(held_out)
    assert network.mae_deg == pytest.approx(statistics.fmean(map(abs, off_deg(held_out))), rel=1e-4)
    assert network.rmse_deg == pytest.approx(rmse(off_deg(held_out)), rel=1e-4)
    turning = [row for row in held_out if abs(row["recorded_deg"]) > 25 * 0.05]
    assert network.turning_mae_deg == pytest.approx(statistics.fmean(map(abs, off_deg(turning))), rel=1e-4)
    predicted = [row["predicted_deg"] for row in held_out]
    assert network.correlation == pytest.approx(statistics.correlation(predicted, recorded), abs=1e-4)
    assert evaluation.measures.mean.rmse_deg == pytest.approx(statistics.pstdev(recorded), rel=1e-6)
    assert evaluation.measures.zero.mae_deg == pytest.approx(statistics.fmean(map(abs, recorded)), rel=1e-6)


def test_each_bin_has_its_own_errors_and_counts_alike_in_the_balanced_one(
    evaluation: Evaluation, held_out: list[Row]
) -> None:
    bins: dict[int, list[Row]] = {}
    for row in held_out:
        bins.setdefault(row["bin"], []).append(row)
    assert [part.bin for part in evaluation.measures.bins] == sorted(bins)
    for part in evaluation.measures.bins:
        off = off_deg(bins[part.bin])
        assert part.frames == len(off)
        assert (part.low, part.high) == pytest.approx((-1 + 0.08 * part.bin, -1 + 0.08 * (part.bin + 1)))
        assert part.mae_deg == pytest.approx(statistics.fmean(map(abs, off)), rel=1e-4)
        assert part.rmse_deg == pytest.approx(rmse(off), rel=1e-4)
        assert part.bias_deg == pytest.approx(statistics.fmean(off), rel=1e-3, abs=1e-4)

    def balanced(constant: float) -> float:
        of_bins = [
            statistics.fmean((constant - row["recorded_deg"]) ** 2 for row in rows) for rows in bins.values()
        ]
        return math.sqrt(statistics.fmean(of_bins))

    mean = statistics.fmean(row["recorded_deg"] for row in held_out)
    expected = math.sqrt(statistics.fmean(rmse(off_deg(rows)) ** 2 for rows in bins.values()))
    assert evaluation.balanced_rmse_deg == pytest.approx(
        {"network": expected, "zero": balanced(0.0), "mean": balanced(mean)}, rel=1e-4
    )


def test_each_session_has_its_own_measures(evaluation: Evaluation, held_out: list[Row]) -> None:
    assert list(evaluation.sessions) == ["a", "b"]
    for session, measures in evaluation.sessions.items():
        rows = [row for row in held_out if row["session"] == session]
        assert measures.frames == len(rows)
        assert measures.network.rmse_deg == pytest.approx(rmse(off_deg(rows)), rel=1e-4)
        recorded = [row["recorded_deg"] for row in rows]
        assert measures.mean.rmse_deg == pytest.approx(statistics.pstdev(recorded), rel=1e-6)


def test_the_frames_are_a_table_of_what_was_measured(evaluation: Evaluation, held_out: list[Row]) -> None:
    frames = evaluation.frames.to_pylist()
    assert [(row["session"], row["row"], row["log_time_ns"]) for row in frames] == [
        (row["session"], row["row"], row["log_time_ns"]) for row in held_out
    ]
    assert {row["camera"] for row in frames} == {"center"}
    for row, expected in zip(frames, held_out, strict=True):
        assert 25 * row["predicted"] == pytest.approx(expected["predicted_deg"], abs=1e-4)
        assert 25 * row["recorded"] == pytest.approx(expected["recorded_deg"], abs=1e-5)


def test_an_evaluation_reports_what_training_said_of_its_best_epoch(
    cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(main, "toy", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    epochs = [json.loads(line) for line in (cwd / "runs" / "toy" / "metrics.jsonl").read_text().splitlines()]
    best = min(epochs, key=lambda epoch: epoch["balanced_rmse_deg"])
    assert result["network"] == pytest.approx(best["validation"], rel=1e-5)
    assert {name: result["mean"][name] for name in best["mean"]} == pytest.approx(best["mean"])
    assert result["bins"][0].keys() == best["bins"][0].keys()
    assert sum(part["frames"] for part in result["bins"]) == sum(part["frames"] for part in best["bins"])


def test_the_worst_frames_are_different_moments(
    cwd: Path, held_out: list[Row], capsys: pytest.CaptureFixture[str]
) -> None:
    """Taken one after the other by hand: the largest error that is no less than a second from those before."""
    expected: list[Row] = []
    for row in sorted(held_out, key=lambda row: -abs(row["off_deg"])):
        near = [
            taken
            for taken in expected
            if taken["session"] == row["session"] and abs(taken["log_time_ns"] - row["log_time_ns"]) < 1e9
        ]
        expected += [] if near else [row]
    assert len(held_out) > len(expected) > 2
    assert call(main, "toy", "--json", "--worst", 1000) == 0
    worst = json.loads(capsys.readouterr().out)["worst"]
    for name in ("session", "row", "log_time_ns"):
        assert [frame[name] for frame in worst] == [row[name] for row in expected]
    for frame, row in zip(worst, expected, strict=True):
        assert frame["predicted_deg"] == pytest.approx(row["predicted_deg"], abs=1e-4)
        assert frame["recorded_deg"] == pytest.approx(row["recorded_deg"], abs=1e-5)
        assert frame["error_deg"] == pytest.approx(row["off_deg"], abs=1e-4)
        time = datetime.fromisoformat(frame["log_time_utc"])
        assert time.timestamp() == pytest.approx(row["log_time_ns"] / 1e9, abs=0.001)
    assert call(main, "toy", "--json", "--worst", 2) == 0
    assert json.loads(capsys.readouterr().out)["worst"] == worst[:2]


@pytest.mark.parametrize(("late", "shown"), [(0, []), (3, ["0.30"])])
def test_the_table_reports_how_late_a_person_steers(
    late: int, shown: list[str], cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    presses = np.random.default_rng(0).choice([-0.6, 0.0, 0.6], 60).repeat(4)
    rows = np.arange(len(presses) - late)
    frames = {"session": ["a"] * len(rows), "row": rows, "log_time_ns": START_NS + 100_000_000 * rows}
    steering = {"recorded": presses[: len(rows)], "predicted": presses[late:], "crash": [False] * len(rows)}
    print_evaluation(replace(evaluate("runs/toy", "index"), frames=pa.table(frames | steering)), [])
    assert re.findall(r"^(\S+) s later +1\.00 ", capsys.readouterr().out, re.MULTILINE) == shown


def test_the_tables_show_the_numbers_of_the_json(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(main, "toy", "--json", "--worst", 2) == 0
    output = capsys.readouterr()
    assert output.err == ""
    (line,) = output.out.splitlines()
    result = json.loads(line)
    assert (result["run"], result["index"], result["split"], result["learnt"]) == ("toy", "index", "validation", 0)

    assert call(main, "toy", "--bins", "--worst", 2) == 0
    output = capsys.readouterr()
    assert output.err == ""
    *lines, verdict, advice = output.out.splitlines()
    assert max(map(len, lines[:-1])) <= 80
    assert f"on turns ({result['network']['turning_mae_deg']:.2f} against" in verdict
    assert advice.startswith("next: `")

    def numbers(start: str) -> list[str]:
        (line,) = (line for line in lines if line.startswith(start))
        return line.removeprefix(start).split()

    beside = ("network", "zero", "mean")
    assert lines[0].startswith(f"toy: {result['frames']} frames")
    for heading, name in (("RMSE ", "rmse_deg"), ("MAE on turns", "turning_mae_deg")):
        assert numbers(heading) == [f"{result[who][name]:.2f}" for who in beside]
    balanced = [
        result["balanced_rmse_deg"],
        result["zero"]["balanced_rmse_deg"],
        result["mean"]["balanced_rmse_deg"],
    ]
    assert numbers("balanced RMSE") == [f"{value:.2f}" for value in balanced]
    assert numbers("correlation") == [f"{result['network']['correlation']:.2f}", "-", "-"]
    assert result["zero"]["correlation"] is None
    for part in result["bins"]:
        expected = [str(part["frames"]), *(f"{part[name]:.2f}" for name in ("mae_deg", "bias_deg", "rmse_deg"))]
        row = numbers(f"{part['low']:+.2f} .. {part['high']:+.2f}")
        assert [value.lstrip("+") for value in row[:4]] == expected
    for session in ("a", "b"):
        assert f"{result['sessions'][session]['network']['rmse_deg']:.2f}" in " ".join(lines)
    assert lines[-1] == "measured on the frames held out of index"


def test_the_name_of_a_run_is_no_markup(
    cwd: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run = shutil.copytree(cwd / "runs" / "toy", tmp_path / "[red]toy")
    monkeypatch.setenv("COLUMNS", "200")
    assert call(main, run, "--index", "index", "--worst", 0) == 0
    shown = capsys.readouterr().out
    assert shown.splitlines()[0].strip().startswith("[red]toy: ")
    assert "worst" not in shown


def test_the_worst_frames_come_with_the_commands_that_show_them(
    cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """--at is in seconds since the log's first message, and never before the frame."""
    assert call(main, "toy", "--json", "--worst", 3) == 0
    worst = json.loads(capsys.readouterr().out)["worst"]
    assert call(main, "toy", "--worst", 3) == 0
    lines = capsys.readouterr().out.splitlines()
    first = lines.index("look at them, the worst one first:") + 1
    for line, frame in zip(lines[first : first + 3], worst, strict=True):
        log = f"sessions/{frame['session']}.mcap"
        command = re.fullmatch(rf"    bc-play {log} --at (\d+\.\d{{3}}) --run toy", line)
        assert command, line
        begin_ns = min(
            message.log_time for messages in read_messages(cwd / log).values() for message, _ in messages
        )
        at_ns = begin_ns + float(command[1]) * 1e9
        assert 0 <= at_ns - frame["log_time_ns"] < 1_500_000


def test_the_command_that_shows_a_frame_is_quoted_for_a_shell(
    cwd: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = Path(shutil.copy(cwd / "sessions" / "new.mcap", tmp_path / "it's new.mcap"))
    run = Path(shutil.copytree(cwd / "runs" / "toy", tmp_path / "my runs" / "toy"))
    assert call(main, "toy", "--runs", run.parent, "--session", log, "--worst", 1) == 0
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "bc-play" in line)
    assert [*shlex.split(line)[:2], *shlex.split(line)[-2:]] == ["bc-play", str(log), "--run", str(run)]


# Which index


def test_a_run_is_measured_on_the_index_that_it_was_trained_on(
    cwd: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(cwd, tmp_path / "moved")
    monkeypatch.chdir(tmp_path / "moved")
    Path("index").rename("my index")
    Path("runs").rename("my runs")
    config = Path("my runs/toy/config.json")
    config.write_text(json.dumps(json.loads(config.read_text()) | {"index": "../../my index"}))
    build_index([Path("sessions/new.mcap")], Path("index"), SPLIT)  # there as well
    assert call(main, "toy", "--runs", "my runs", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["index"], list(result["sessions"])) == ("my index", ["a", "b"])
    assert call(main, "my runs/toy") == 0
    assert capsys.readouterr().out.splitlines()[-3] == "measured on the frames held out of my index"
    assert call(main, "my runs/toy", "--index", "index", "--json") == 0
    assert list(json.loads(capsys.readouterr().out)["sessions"]) == ["new"]
    shutil.rmtree("my index")
    assert call(main, "my runs/toy") == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "my index: the index that my runs/toy was trained on is missing; give --index" in line


# What the run has learnt from


@pytest.fixture
def run(cwd: Path, tmp_path: Path) -> Path:
    """A copy of the run that a test may change."""
    without_its_checkpoint = shutil.ignore_patterns("last")  # 60 MB
    run = Path(shutil.copytree(cwd / "runs" / "toy", tmp_path / "changed", ignore=without_its_checkpoint))
    change(run, index=str(cwd / "index"))
    return run


def change(run: Path, **values: Any) -> None:
    config = json.loads((run / "config.json").read_text())
    (run / "config.json").write_text(json.dumps({**config, **values}))


def data_of(run: Path) -> Row:
    data: Row = json.loads((run / "config.json").read_text())["data"]
    return data


def for_training(folder: Path, session: str) -> set[int]:
    """The rows of a session that the run's index gives to training."""
    frames = pq.read_table(folder / "index" / "frames" / f"{session}.parquet").to_pylist()
    return {row["row"] for row in frames if row["split"] == "train"}


def test_frames_for_training_can_be_measured_and_that_is_said(
    cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    count = sum(len(for_training(cwd, session)) for session in ("a", "b"))
    assert call(main, "toy", "--split", "train", "--json") == 0
    output = capsys.readouterr()
    result = json.loads(output.out)
    assert 0 < result["frames"] <= count  # balancing leaves some out
    assert result["learnt"] == result["frames"]
    (line,) = output.err.splitlines()
    assert line == f"bc-eval: toy has learnt from {result['frames']} of these {result['frames']} frames"


def test_frames_of_crashes_are_reported_apart(
    cwd: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three seconds at a wall: the errors of all frames, and of all but these."""
    wall = range(25, 55)
    log = tmp_path / "crash.mcap"
    with LogWriter(log, {"source": "test"}) as writer:
        for row in range(60):
            time_ns = START_NS + row * 10**8
            state = VehicleState(steering=0.9 if row in wall else 0.01 * row, speed_mph=0.1 if row in wall else 20)
            writer.picture("center", time_ns, row, road("center", row % len(STEERING)))
            writer.vehicle(time_ns, row, state)
    assert call(main, "toy", "--session", log, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    frames = evaluate_sessions(cwd / "runs" / "toy", [log]).frames.to_pylist()
    off = {row["row"]: 25 * (row["predicted"] - row["recorded"]) for row in frames}
    crash = {row["row"] for row in frames if row["crash"]}
    assert {*wall, *range(15, 25)} <= crash  # and the approach
    rmse = {
        name: math.sqrt(statistics.fmean(off[row] ** 2 for row in rows))
        for name, rows in (("all", off), ("others", off.keys() - crash))
    }
    assert (result["crashes"], result["without_crashes"]["frames"]) == (len(crash), 60 - len(crash))
    assert result["network"]["rmse_deg"] == pytest.approx(rmse["all"])
    assert result["without_crashes"]["network"]["rmse_deg"] == pytest.approx(rmse["others"])
    assert result["without_crashes"]["mean"]["balanced_rmse_deg"] > 0
    assert call(main, "toy", "--session", log) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert f"RMSE without crashes ({len(crash)}) {rmse['others']:.2f}" in printed
    assert f"the verdict is without {len(crash)} frames of crashes" in printed
    assert f"({rmse['others']:.2f} against" in printed
    assert f"({rmse['all']:.2f} against" not in printed
    assert call(main, "toy", "--session", "new", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["crashes"], result["without_crashes"]) == (0, None)


def test_whole_sessions_that_the_run_never_had_are_measured_by_frame(
    cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(main, "toy", "--session", "new", "--json") == 0
    output = capsys.readouterr()
    assert output.err == ""
    result = json.loads(output.out)
    assert (result["frames"], result["learnt"], list(result["sessions"])) == (len(STEERING), 0, ["new"])
    pilot = load_pilot(cwd / "runs" / "toy", "float32")
    off = [
        25 * (pilot.predict(pilot.crop(decode(road("center", row)))) - steering)
        for row, steering in enumerate(STEERING[::-1])
    ]
    assert result["network"]["mae_deg"] == pytest.approx(statistics.fmean(map(abs, off)), rel=1e-4)
    assert result["worst"][0]["row"] == max(range(len(off)), key=lambda row: abs(off[row]))


def test_a_session_that_the_run_has_learnt_from_is_known_by_its_bytes(
    cwd: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(cwd / "sessions" / "a.mcap", tmp_path / "under_another_name.mcap")
    count = len(for_training(cwd, "a"))
    assert 0 < count < len(STEERING)
    assert call(main, "toy", "--session", "under_another_name", "--sessions", tmp_path) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"toy has learnt from {count} of these {len(STEERING)} frames")


def test_an_index_that_splits_otherwise_is_seen_through(
    cwd: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = [cwd / "sessions" / f"{session}.mcap" for session in ("a", "b")]
    index = build_index(logs, tmp_path / "index", replace(SPLIT, seed=1)).path
    frames = [row for file in (index / "frames").glob("*.parquet") for row in pq.read_table(file).to_pylist()]
    learnt = {session: for_training(cwd, session) for session in ("a", "b")}
    count = sum(
        row["row"] in learnt[row["session"]]
        for row in frames
        if row["split"] == "validation" and row["camera"] == "center"
    )
    assert count > 0
    assert call(main, "toy", "--index", index) == 3
    assert f"toy has learnt from {count} of these" in capsys.readouterr().err


def test_a_fine_tuned_run_has_learnt_what_the_run_before_it_has(
    cwd: Path, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = data_of(run)
    change(run, data={**data, "logs": {}}, init={"data": [data]})
    assert call(main, run, "--session", "b") == 3
    assert f"has learnt from {len(for_training(cwd, 'b'))} of these {len(LEFT)} frames" in capsys.readouterr().err


def edited(data: Row, part: str, **values: Any) -> Row:
    return {**data, part: {**data[part], **values}}


@pytest.mark.parametrize(
    "output",
    [
        lambda data: {"data": None},
        lambda data: {"data": [1]},
        lambda data: {"data": {"logs": data["logs"]}},
        lambda data: {"data": edited(data, "settings", block_s="long")},
        lambda data: {"data": edited(data, "settings", seed=1e999)},
        lambda data: {"data": edited(data, "logs", a="log")},
        lambda data: {"data": {**data, "logs": {"\ud800": data["logs"]["a"]}}},
        lambda data: {"init": {"run": "older"}},
    ],
)
def test_a_run_that_does_not_say_what_it_has_learnt_from_is_not_trusted(
    run: Path, capsys: pytest.CaptureFixture[str], output: Any
) -> None:
    change(run, **output(data_of(run)))
    assert call(main, run, "--json") == 3
    shown = capsys.readouterr()
    assert json.loads(shown.out)["learnt"] is None
    (line,) = shown.err.splitlines()
    assert "does not record its training data" in line


# What cannot be measured


def test_undecodable_pictures_are_named_and_the_others_keep_their_places(
    cwd: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def picture(camera: Camera, row: int) -> bytes:
        return not_a_picture(camera, row) if row in (3, 17) else road(camera, row)

    log = write_log(tmp_path / "torn.mcap", STEERING, picture, cameras=["center"])
    assert call(main, "toy", "--session", log, "--json", "--worst", 1000) == 3
    shown = capsys.readouterr()
    result = json.loads(shown.out)
    (count,) = result["skipped"].values()
    assert (result["frames"], count) == (len(STEERING) - 2, 2)
    (line,) = shown.err.splitlines()
    assert "torn row 3 center" in line
    assert "torn row 17 center" in line
    whole = evaluate_sessions(cwd / "runs" / "toy", [cwd / "sessions" / "a.mcap"])
    expected = {row["row"]: row["predicted"] for row in whole.frames.to_pylist() if row["row"] not in (3, 17)}
    torn = evaluate_sessions(cwd / "runs" / "toy", [log]).frames.to_pylist()
    assert {row["row"]: row["predicted"] for row in torn} == pytest.approx(expected, abs=1e-6)


def test_a_session_of_which_nothing_is_measured_is_named(
    cwd: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_log(tmp_path / "aside.mcap", LEFT, left_road, cameras=["left"])
    assert call(main, "toy", "--session", "new", log) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"{log}: not measured")


def test_an_unfinished_log_is_measured_as_far_as_it_is_whole(
    cwd: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "killed.mcap"
    data = (cwd / "sessions" / "new.mcap").read_bytes()
    log.write_bytes(data[: len(data) - 200])
    assert call(main, "toy", "--session", log) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert "bc-log recover" in line


def test_a_network_of_no_numbers_is_one_line(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    weights = load_file(run / "model.safetensors")
    name = next(name for name, tensor in weights.items() if tensor.shape == (1,))
    save_file({**weights, name: np.full(1, np.nan, np.float32)}, run / "model.safetensors")
    assert call(main, run) == 1
    unsealed, line = capsys.readouterr().err.splitlines()
    assert "without checksums" in unsealed
    assert "not finite" in line


@pytest.mark.parametrize(
    ("flags", "text"),
    [
        (["--laps", 2], "--laps: no such flag"),
        (["drive", "toy", "--tracks"], "--tracks: expected TRACK [TRACK ...] after it"),
        (["drive", "toy", "--tracks", "lake", "lake"], "--tracks lake lake: "),
        (["drive", "toy", "--tracks", "lake", "--laps", 0], "--laps 0: "),
        (["drive", "toy", "--tracks", "lake", "--speed", "nan"], "--speed nan: "),
        (["--session"], "--session: expected SESSION [SESSION ...] after it"),
        (["--session", "a", "--split", "train"], "leave out --index and --split"),
        (["--worst", -1], "--worst -1"),
        (["--session", "nobody"], "nobody.mcap: no such log"),
        (["--index", "nowhere"], "build it with `bc-index --index nowhere`"),
    ],
)
def test_flags_that_do_not_go_together_are_one_line(
    cwd: Path, capsys: pytest.CaptureFixture[str], flags: list[object], text: str
) -> None:
    missing = {"nobody", "nowhere"}.intersection(map(str, flags))  # what could be there is no bad usage
    run = [] if "drive" in flags else ["toy"]
    assert call(main, *run, *flags) == (1 if missing else 2)
    shown = capsys.readouterr()
    (line,) = shown.err.splitlines()
    assert text in line
    assert shown.out == ""
    assert not (cwd / "drives").exists()
