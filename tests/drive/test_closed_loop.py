"""The built-in simulator: what it records is a log like any other, and what it drives can be repeated."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from common.process_settings import usable_cores
from drive.cli import main as drive_main
from drive.config import DriveConfig
from drive.evaluation.closed_loop import BuiltInSimulator, evaluate
from drive.evaluation.eval_cli import main as eval_main
from model import load_pilot
from recorder import Imported, Log, import_udacity
from recorder.cli import main as record_main
from recorder.log.session_car import BUILT_IN, car_in
from recorder.sources.built_in_simulator import record_simulated
from recorder.sources.settings import SimulatedDrive
from simulator.cli import main as sim_main
from tests.helpers.driving import Process as Child
from tests.helpers.driving import command, one_line_in, run, untrained_run
from tests.helpers.logs import read_messages
from tests.helpers.udacity import call

DRIVE = SimulatedDrive(track="lake", laps=0.01, seed=5)
CAMERAS = ("/camera/center", "/camera/left", "/camera/right")


def pictures(path: Path, camera: str) -> list[bytes]:
    return [image.data for _, image in read_messages(path)[camera]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recorded")


@pytest.fixture(scope="module")
def recorded(folder: Path) -> Imported:
    return record_simulated(DRIVE, folder / "lake.mcap", udacity=folder / "beta_simulator")


def test_a_recording_has_cameras_vehicle_and_pose_at_equal_times(recorded: Imported) -> None:
    messages = read_messages(recorded.path)
    stamps = [
        [(message.sequence, message.log_time) for message, _ in messages[topic]]
        for topic in (*CAMERAS, "/vehicle", "/pose")
    ]
    assert len(stamps[0]) == recorded.rows == recorded.pictures // 3 > 20
    assert all(stamp == stamps[0] for stamp in stamps)
    assert [sequence for sequence, _ in stamps[0]] == list(range(recorded.rows))
    gaps_ns = {after - before for (_, before), (_, after) in zip(stamps[0], stamps[0][1:], strict=False)}
    assert min(gaps_ns) == 100_000_000  # 10 rows a second
    assert all(gap_ns == 100_000_000 or gap_ns >= 1_000_000_000 for gap_ns in gaps_ns)  # pushes are gaps


def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not(recorded: Imported, tmp_path: Path) -> None:
    again = record_simulated(DRIVE, tmp_path / "again.mcap")
    assert again.path.read_bytes() == recorded.path.read_bytes()
    other = record_simulated(SimulatedDrive(track="lake", laps=0.002, seed=6), tmp_path / "other.mcap")
    states, others = (
        [state for _, state in read_messages(path)["/vehicle"]] for path in (recorded.path, other.path)
    )
    assert others != states[: other.rows]


def test_the_folder_it_writes_imports_to_the_same_session(
    folder: Path, recorded: Imported, tmp_path: Path
) -> None:
    imported = import_udacity(folder / "beta_simulator", tmp_path / "imported.mcap")
    assert (imported.rows, imported.pictures, len(imported.skipped)) == (recorded.rows, recorded.pictures, 0)
    for camera in CAMERAS:
        assert pictures(imported.path, camera) == pictures(recorded.path, camera)
    ours, theirs = (read_messages(path)["/vehicle"] for path in (recorded.path, imported.path))
    assert [message.log_time for message, _ in ours] == [message.log_time for message, _ in theirs]
    for (_, mine), (_, read) in zip(ours, theirs, strict=True):
        for name in ("steering", "throttle", "brake", "speed_mph"):
            assert getattr(read, name) == pytest.approx(getattr(mine, name), rel=5e-7, abs=1e-12)


@pytest.mark.parametrize(
    ("main", "arguments"),
    [
        (sim_main, ("--port", "1", "--wait", "0", "--track")),
        (record_main, ("x", "--track")),
        (drive_main, ("--simulator",)),
        (eval_main, ("drive", "--tracks")),
    ],
)
def test_an_unknown_track_ends_every_command_with_one_code_and_a_guess(
    main: Callable[[], None],
    arguments: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(main, *arguments, "lkae") == 1
    assert "lkae: no such track; did you mean lake?" in one_line_in(capsys)


@pytest.mark.parametrize(
    "flag",
    [
        *("--rate 7", "--rate 0", "--rate nan", "--laps nan", "--laps 0", "--laps inf", "--speed 0"),
        *("--speed nan", "--recovery 0.95", "--recovery nan", "--noise -1", "--noise nan", "--seed -1"),
    ],
)
def test_an_impossible_drive_of_bc_record_is_one_line_with_the_flag(
    flag: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(record_main, "x", "--sessions", tmp_path, *flag.split()) == 2
    assert f"bc-record: {flag}: " in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def pilot_run(folder: Path) -> Path:
    return untrained_run(folder / "runs" / "untrained", seed=1)


def test_two_evaluations_go_the_same_way_and_each_is_logged(pilot_run: Path, tmp_path: Path) -> None:
    """One here, one as a user calls it."""
    drives = [(BuiltInSimulator("lake", 0.002), DriveConfig())]
    with Child(
        command(
            "bc-eval",
            "drive",
            pilot_run,
            "--tracks",
            "lake",
            "--laps",
            0.002,
            "--drives",
            tmp_path / "b",
            "--json",
        )
    ) as child:
        (called,) = evaluate(load_pilot(pilot_run), drives, tmp_path / "a")
        assert child.join() == 0, child.stderr
    (line,) = child.stdout.splitlines()
    printed = json.loads(line)
    assert called.as_dict() == {**printed, "log": str(called.log)}
    assert len(printed["trajectory_sha256"]) == 64
    assert 0.002 <= printed["laps"] < 0.004
    assert {"track", "set_speed_mph", "interventions", "autonomy_percent", "mean_offset", "max_offset"} <= set(
        printed
    )
    assert {"mean_speed_mph", "steering_per_s", "elapsed_s", "whole_laps", "unreadable"} <= set(printed)
    expected = max(0.0, 100 * (1 - 6 * printed["interventions"] / printed["elapsed_s"]))
    assert printed["autonomy_percent"] == pytest.approx(expected)
    assert Path(printed["log"]).name == called.log.name
    ours, theirs = (pictures(Path(str(path)), "/camera/center") for path in (called.log, printed["log"]))
    # 25 telemetries a second; two are in flight when the drive is over
    assert len(ours) == pytest.approx(called.report["elapsed_s"] * 25, abs=2)
    assert ours == theirs
    with Log(called.log) as log:
        assert log.read_metadata("bc.simulator")["trajectory_sha256"] == printed["trajectory_sha256"]
        assert log.metadata["track"] == "lake"  # of its map
        assert car_in(log.metadata, log.path) == BUILT_IN  # where its cameras stand, and how it turns


@pytest.mark.needs("no_gpu")
@pytest.mark.parametrize(
    ("main", "verb", "tracks"), [(drive_main, (), "--simulator"), (eval_main, ("drive",), "--tracks")]
)
def test_a_gpu_that_is_not_there_is_one_line(
    pilot_run: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    main: Callable[[], None],
    verb: tuple[str, ...],
    tracks: str,
) -> None:
    flags = (tracks, "lake", "--drives", tmp_path / "logs", "--device", "cuda")
    assert call(main, *verb, pilot_run, *flags) == 1
    assert "--device cuda: PyTorch finds no GPU; give --device cpu" in one_line_in(capsys)
    assert not (tmp_path / "logs").exists()


def test_bc_drive_with_the_built_in_simulator_ends_by_itself_with_a_log(pilot_run: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    done = run("bc-drive", pilot_run, "--log", log, "--simulator", "lake", "--laps", 0.002)
    assert done.returncode == 0, done.stderr
    logged, driven, *rest = done.stdout.splitlines()
    assert logged.startswith(f"{log}: ")
    assert "laps" in driven
    assert "autonomy" in rest[0]
    with Log(log) as written:
        assert written.counts["/camera/center"] == written.counts["/pilot/command"] > 10


@pytest.mark.parametrize("tracks", [("lake",), ("lake", "mountain")])
def test_an_evaluation_that_is_stopped_keeps_what_it_drove(
    pilot_run: Path, tmp_path: Path, tracks: tuple[str, ...]
) -> None:
    logs, at_once = tmp_path / "drives", min(len(tracks), usable_cores())
    with Child(
        command("bc-eval", "drive", pilot_run, "--tracks", *tracks, "--laps", 1, "--drives", logs)
    ) as process:
        while sum(part.stat().st_size > 100_000 for part in logs.glob("*.part")) < at_once:
            assert process.popen.poll() is None, process.stderr
            time.sleep(0.05)  # until they are in the middle of driving
        assert process.end(signal.SIGTERM) == 130
    assert not any(word in "\n".join(process.stderr) for word in ("Traceback", "connecting", "ws://"))
    assert {path.suffix for path in logs.iterdir()} == {".mcap"}


def test_drives_at_the_same_time_are_those_that_are_driven_alone(pilot_run: Path, tmp_path: Path) -> None:
    settings = ("--laps", 0.004, "--speed", 10, 20, "--json", "--drives")
    together = run("bc-eval", "drive", pilot_run, "--tracks", "lake", "mountain", *settings, tmp_path / "together")
    assert together.returncode == 0, together.stderr
    alone = "".join(
        run(
            "bc-eval",
            "drive",
            pilot_run,
            "--tracks",
            track,
            "--speed",
            speed,
            *settings[:2],
            "--json",
            "--drives",
            tmp_path / "alone",
        ).stdout
        for speed in (10, 20)
        for track in ("lake", "mountain")
    )
    assert by_log(together.stdout) == by_log(alone)


def by_log(printed: str) -> dict[str, dict[str, object]]:
    """The results of drives by the names of their logs, without what depends on the clock and the folder."""
    results = [json.loads(line) for line in printed.splitlines()]
    return {Path(result.pop("log")).name: result for result in results}
