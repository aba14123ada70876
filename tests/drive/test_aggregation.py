"""`bc-drive --aggregate`: the expert takes over where the network fails, and the network learns from that."""

from __future__ import annotations

import io
import itertools
import json
import math
import os
import shutil
import signal
import time
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader

from dataset import DatasetError, IndexConfig, build_index
from drive.cli import main as drive_main
from drive.config import DriveConfig
from drive.evaluation.aggregation import Aggregation
from drive.evaluation.simulator_process import BuiltInSimulator
from driving import Process, call_drive, command, one_line_in, road_jpeg
from logs import write_log
from model import TrainConfig, train
from model.cli import main
from model.runs.checkpoint import read_position
from model.runs.training_progress import METRICS_FILE
from places import as_bucket
from recorder import Log
from recorder.bc_pb2 import PilotCommand
from recorder.log.session_car import Car, stored_car
from recorder.topics import DRIVE_METADATA
from serving import ModernClient, fields
from simulator.protocol.client import ServerCommand, SimulatorClient, SimulatorMessage, SimulatorTelemetry
from udacity import call
from waiting import wait_until

TRACK, LAPS, SPEED = "random:3", 0.04, 20
SETTINGS = IndexConfig(cameras=("center",), balance=False, flip=False, block_s=1.0, gap_s=0.0)


@dataclass(frozen=True)
class Aggregated:
    folder: Path
    exit_code: int
    table: list[str]
    said: list[str]


@pytest.fixture(scope="module")
def aggregated(tmp_path_factory: pytest.TempPathFactory) -> Aggregated:
    """A network that has learnt next to nothing, and drives another track; by now, one of its two sessions is
    damaged. What it makes is kept in a store, too."""
    folder = tmp_path_factory.mktemp("aggregated")
    train_on_what_is_damaged(folder, "first")
    store = folder / "store"
    store.mkdir()
    with as_bucket(store) as variables:
        return aggregate(
            folder, "first", 1, "--runs", "s3://store/runs", "--drives", "s3://store/drives", **variables
        )


def a_session(path: Path, first: int, rows: int, car: Car | None = None) -> Path:
    """A session of so many of the drawn pictures, none of which another one may have."""
    steering = [0.3 * math.sin(row / 9) for row in range(rows)]
    return write_log(path, steering, lambda camera, row: road_jpeg(first + row), cameras=["center"], car=car)


def train_on_what_is_damaged(folder: Path, run_name: str) -> None:
    """A run that was trained on two sessions, lake and hurt, of which the second is damaged now."""
    logs = [
        a_session(folder / "sessions" / f"{name}.mcap", first, rows)
        for name, first, rows in (("lake", 0, 60), ("hurt", 100, 40))
    ]
    build_index(logs, folder / "index", SETTINGS)
    config = TrainConfig(network="small", epochs=1, batch=32)
    train(folder / "index", folder / "runs" / run_name, config, show_progress=False)
    with logs[1].open("r+b") as hurt:
        summary = make_reader(hurt).get_summary()
        assert summary is not None
        (states,) = (number for number, channel in summary.channels.items() if channel.topic == "/vehicle")
        chunk = next(chunk for chunk in summary.chunk_indexes if states in chunk.message_index_offsets)
        hurt.seek(chunk.chunk_start_offset + chunk.chunk_length // 2)
        (byte,) = hurt.read(1)
        hurt.seek(-1, os.SEEK_CUR)
        hurt.write(bytes([byte ^ 1]))


def aggregate(folder: Path, run_name: str, rounds: int, *flags: str, **variables: str) -> Aggregated:
    drive = (f"runs/{run_name}", *flags, "--simulator", TRACK, "--laps", LAPS, "--speed", SPEED)
    out, said = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(said):
        patch.chdir(folder)
        for name, value in {"COLUMNS": "400", **variables}.items():
            patch.setenv(name, value)
        code = call_drive(*drive, "--aggregate", rounds, "--epochs", 1)
    return Aggregated(folder, code, out.getvalue().splitlines(), said.getvalue().splitlines())


def test_what_every_round_has_made_is_copied_to_the_store(aggregated: Aggregated) -> None:
    store = aggregated.folder / "store"
    logs = [store / f"drives/first-random-3-{number}.mcap" for number in (0, 1)]
    for copy in (*logs, store / "runs/first-random-3-1/model.safetensors"):
        assert copy.read_bytes() == (aggregated.folder / copy.relative_to(store)).read_bytes()


def commands(log: Path) -> list[PilotCommand]:
    with Log(log) as opened:
        return [content for _, content in opened.commands()]


def test_every_round_is_driven_logged_and_shown(aggregated: Aggregated) -> None:
    heading, *rows = aggregated.table
    assert heading.split() == ["run", "laps", "interventions", "autonomy", "log"]
    runs = ["first", "first-random-3-1"]
    assert [row.split()[0] for row in rows] == runs
    for row, number in zip(rows, (0, 1), strict=True):
        log = aggregated.folder / "drives" / f"first-random-3-{number}.mcap"
        assert row.split()[-1] == f"drives/{log.name}"
        with Log(log) as opened:
            assert opened.metadata["run"] == runs[number]
            assert not opened.problem


def check_what_is_damaged_was_left_out(done: Aggregated, run_name: str, rounds: int) -> None:
    assert done.exit_code == 3, done.said
    (warning,) = (line for line in done.said if "left out" in line)  # once, and not in each round
    assert warning.startswith("sessions/hurt.mcap: ")
    learnt = json.loads((done.folder / "runs" / f"{run_name}-random-3-{rounds}" / "config.json").read_text())
    assert set(learnt["data"]["logs"]) == {"lake", *(f"{run_name}-random-3-{driven}" for driven in range(rounds))}


def test_a_session_that_is_damaged_by_now_is_left_out_and_said(aggregated: Aggregated) -> None:
    check_what_is_damaged_was_left_out(aggregated, "first", 1)


@pytest.mark.long  # one round: above
def test_a_session_that_is_damaged_is_said_once_in_all_rounds(tmp_path: Path) -> None:
    train_on_what_is_damaged(tmp_path, "two")
    check_what_is_damaged_was_left_out(aggregate(tmp_path, "two", 2), "two", 2)


def test_the_expert_took_over_and_steered(aggregated: Aggregated) -> None:
    driven = commands(aggregated.folder / "drives" / "first-random-3-0.mcap")
    expert = [command for command in driven if command.driver == PilotCommand.EXPERT]
    assert expert
    assert any(command.driver == PilotCommand.PILOT for command in driven)
    assert all(command.steering == command.expert_steering for command in expert)
    starts = sum(now.driver == PilotCommand.EXPERT != before.driver for before, now in itertools.pairwise(driven))
    assert int(aggregated.table[1].split()[2]) >= starts > 0


def test_the_new_run_learns_from_the_session_and_the_takeovers_alone(aggregated: Aggregated) -> None:
    folder = aggregated.folder
    config = json.loads((folder / "runs" / "first-random-3-1" / "config.json").read_text())
    assert set(config["data"]["logs"]) == {"lake", "first-random-3-0"}
    assert config["data"]["settings"]["drives"] == "takeovers"
    assert config["init"]["run"] == "first"
    samples = pq.read_table(folder / "index-first-random-3" / "samples.parquet").to_pylist()
    driven = commands(folder / "drives" / "first-random-3-0.mcap")
    of_drive = [sample for sample in samples if sample["session"] == "first-random-3-0"]
    assert of_drive
    assert all(driven[sample["row"]].driver == PilotCommand.EXPERT for sample in of_drive)
    assert {sample["session"] for sample in samples} == {"lake", "first-random-3-0"}


def aggregation(aggregated: Aggregated, run_name: str, sessions: Path) -> Aggregation:
    runs, drives = aggregated.folder / "runs", aggregated.folder / "drives"
    simulator, training = BuiltInSimulator("random:4"), TrainConfig(epochs=1)
    return Aggregation(
        runs / run_name, simulator, DriveConfig(), 1, training, sessions=sessions, drives=drives, runs=runs
    )


def test_the_new_run_can_go_on_from_there(aggregated: Aggregated) -> None:
    assert aggregation(aggregated, "first-random-3-1", aggregated.folder / "sessions")


def test_another_log_in_the_place_of_one_that_was_learnt_from_is_refused(
    aggregated: Aggregated, tmp_path: Path
) -> None:
    shutil.copy(aggregated.folder / "sessions" / "hurt.mcap", tmp_path)
    a_session(tmp_path / "lake.mcap", 200, 50)
    with pytest.raises(DatasetError, match=r"lake\.mcap: changed since the run learned from it"):
        aggregation(aggregated, "first", tmp_path)


def test_a_second_aggregation_of_the_same_names_is_refused_at_once(
    aggregated: Aggregated, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(aggregated.folder)
    assert call(drive_main, "first", "--simulator", TRACK, "--aggregate", 1) == 1
    in_the_way = (
        "drives/first-random-3-0.mcap drives/first-random-3-1.mcap index-first-random-3 runs/first-random-3-1"
    )
    assert one_line_in(capsys).endswith(f"move them away: {in_the_way}")


def start_aggregation(aggregated: Aggregated, track: str, *flags: object) -> Process:
    arguments = ("first", "--simulator", track, "--speed", SPEED, "--aggregate", 2, *flags)
    return Process(command("bc-drive", *arguments), aggregated.folder)


def test_a_training_that_is_stopped_says_how_to_finish_it(
    aggregated: Aggregated, monkeypatch: pytest.MonkeyPatch
) -> None:
    with start_aggregation(aggregated, "random:5", "--laps", 0.01, "--epochs", 10_000) as process:
        process.wait_for("training runs/first-random-5-1")
        trained = aggregated.folder / "runs" / "first-random-5-1"
        # one that has learnt nothing yet leaves nothing
        wait_until(lambda: (trained / METRICS_FILE).exists() and b"\n" in (trained / METRICS_FILE).read_bytes())
        assert process.end() == 130
    stopped = process.wait_for(
        r"^bc-drive: finish (\S+) with `bc-train (.+)`; then go on with `bc-drive (.+)` and "
    )
    assert stopped[1] == "runs/first-random-5-1"
    assert stopped[3] == "runs/first-random-5-1 --simulator random:5 --aggregate 1"
    epoch = read_position(aggregated.folder / stopped[1]).epoch
    monkeypatch.chdir(aggregated.folder)
    assert call(main, *stopped[2].split(), "--epochs", epoch) == 0


def test_a_drive_that_is_stopped_says_what_is_left(aggregated: Aggregated) -> None:
    with start_aggregation(aggregated, "random:6") as process:
        while not any(part.stat().st_size > 100_000 for part in (aggregated.folder / "drives").glob("*.part")):
            assert process.popen.poll() is None, process.stderr
            time.sleep(0.05)
        assert process.end() == 130
    log = "drives/first-random-6-0.mcap"
    process.wait_for(f"^bc-drive: {log} holds the drive so far; to begin again, move away {log}$")
    with Log(aggregated.folder / log) as opened:
        assert not opened.problem


def simulate(port: str, *flags: object) -> Process:
    """A simulator that connects by itself, and tells where its car is and what its expert would do."""
    arguments = ("--port", port, "--track", TRACK, "--tell-world", "--leave-off-road", "--expert-speed", SPEED)
    return Process(command("bc-sim", *arguments, *flags))


@pytest.mark.long
def test_a_simulator_that_connects_by_itself_is_waited_for_in_every_round(aggregated: Aggregated) -> None:
    """It disconnects after the first one, and is stopped by the laps that it tells in the second. The network is
    that of an aggregation before."""
    runs = aggregated.folder / "runs"
    shutil.copytree(runs / "first-random-3-1", runs / "next")
    aggregate = ("next", "--port", 0, "--speed", SPEED, "--aggregate", 1, "--epochs", 1, "--laps", LAPS)
    with Process(command("bc-drive", *aggregate), aggregated.folder) as process:
        port = process.wait_for(r"next is waiting for a simulator on 127\.0\.0\.1:(\d+)")[1]
        with simulate(port, "--laps", 0.9 * LAPS) as short:
            process.wait_for("training runs/next-connected-1")
            assert short.join() == 0
        port = process.wait_for(r"next-connected-1 is waiting for a simulator on 127\.0\.0\.1:(\d+)")[1]
        with simulate(port, "--laps", 50):
            assert process.join() == 0, process.stderr
    assert any(line.endswith("the car is braked to a stand") for line in process.stderr)
    assert not any("Ctrl-C" in line for line in process.stderr)  # nobody pressed it
    _, first, second = process.stdout.splitlines()
    assert (first.split()[0], second.split()[0]) == ("next", "next-connected-1")
    assert second.split()[-1] == "drives/next-connected-1.mcap"
    laps, drivers = [], []
    for log in sorted((aggregated.folder / "drives").glob("next-connected-*.mcap")):
        drivers.append({each.driver for each in commands(log)})
        with Log(log) as opened:
            laps.append(float(opened.read_metadata(DRIVE_METADATA)["laps"]))
    assert laps[0] < LAPS <= laps[1] < 2 * LAPS
    assert PilotCommand.EXPERT in drivers[0]
    learnt = json.loads((runs / "next-connected-1" / "config.json").read_text())
    assert set(learnt["data"]["logs"]) == {"lake", "first-random-3-0", "next-connected-0"}


TORCS = Car(max_steering_deg=23.0, wheelbase_m=2.6, speed_unit="km/h")


def drive_off_the_road(port: int, first: int) -> None:
    """A simulator of that car, 36 km/h fast; it is so far to the left that its expert steers to the right."""
    rows = iter(range(40))

    def next_telemetry(command: ServerCommand) -> SimulatorMessage:
        if command is None and client.steers == 0 and client.telemetries == 1:
            return "nothing"  # in lock step
        if (row := next(rows, None)) is None:
            return None
        world = {"time_s": row / 20, "offset": 0.95, "expert_steering": 0.5, "expert_throttle": 0.2}
        return SimulatorTelemetry(0.1, 0.2, 36.0, road_jpeg(first + row), world)

    client = SimulatorClient(port=port, max_steering_deg=TORCS.max_steering_deg)
    client.run(next_telemetry)


def test_a_simulator_of_another_car_goes_through_all_rounds(tmp_path: Path) -> None:
    session = a_session(tmp_path / "sessions" / "torcs.mcap", 0, 60, TORCS)
    build_index([session], tmp_path / "index", SETTINGS)
    config = TrainConfig(network="small", epochs=1, batch=32)
    train(tmp_path / "index", tmp_path / "runs" / "torcs", config, show_progress=False)
    aggregate = ("torcs", "--port", 0, "--aggregate", 2, "--epochs", 1, "--viewer", "off")
    with Process(command("bc-drive", *aggregate), tmp_path) as process:
        for number, run_name in enumerate(("torcs", "torcs-connected-1", "torcs-connected-2")):
            port = process.wait_for(rf"{run_name} is waiting for a simulator on 127\.0\.0\.1:(\d+)")[1]
            drive_off_the_road(int(port), 100 * (number + 1))
        assert process.join() == 0, process.stderr
    for number in range(3):
        with Log(tmp_path / "drives" / f"torcs-connected-{number}.mcap") as log:
            assert stored_car(log) == TORCS
            assert log.vehicle()["steering"].to_pylist() == pytest.approx([0.1] * 40)
            assert log.vehicle()["speed_mph"].to_pylist() == pytest.approx([22.369] * 40, abs=1e-3)
    learnt = json.loads((tmp_path / "runs" / "torcs-connected-2" / "config.json").read_text())
    assert {each["max_steering_deg"] for each in learnt["data"]["logs"].values()} == {23.0}
    samples = pq.read_table(tmp_path / "index-torcs-connected" / "samples.parquet").to_pylist()
    expert = [each["label"] for each in samples if each["session"] != "torcs"]
    assert {abs(label) for label in expert} == {0.5}


def test_a_second_ctrl_c_brakes_no_longer_and_finishes_the_log(aggregated: Aggregated) -> None:
    shutil.copytree(aggregated.folder / "runs" / "first", aggregated.folder / "runs" / "twice")
    with Process(command("bc-drive", "twice", "--port", 0, "--aggregate", 1), aggregated.folder) as process:
        port = process.wait_for(r"twice is waiting for a simulator on 127\.0\.0\.1:(\d+)")[1]
        client = ModernClient(int(port))  # it tells once, and is silent then
        client.tell(fields(0, speed="30.0000"))
        process.popen.send_signal(signal.SIGINT)
        process.wait_for("the car is braked to a stand; Ctrl-C again ends at once")
        process.popen.send_signal(signal.SIGINT)
        assert process.join() == 130
        client.close()
    assert not any(".part" in line for line in process.stderr), process.stderr
    with Log(aggregated.folder / "drives" / "twice-connected-0.mcap") as opened:
        assert not opened.problem


def test_a_simulator_without_an_expert_ends_it_at_once_and_is_told_why(aggregated: Aggregated) -> None:
    runs = aggregated.folder / "runs"
    shutil.copytree(runs / "first", runs / "alone")
    with Process(command("bc-drive", "alone", "--port", 0, "--aggregate", 1), aggregated.folder) as process:
        port = process.wait_for(r"alone is waiting for a simulator on 127\.0\.0\.1:(\d+)")[1]
        with Process(command("bc-sim", "--port", port, "--laps", 50)):
            assert process.join() == 1
    log = "drives/alone-connected-0.mcap"
    process.wait_for(f"{log}: nobody could take over, .* never sends offset, expert_steering, expert_throttle ")
    with Log(aggregated.folder / log) as opened:
        assert not opened.problem


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (("--aggregate", "1", "--real-time"), "--simulator TRACK"),
        (("--aggregate", "1", "--laps", "0"), "--laps 0: give a number above 0"),
        (("--aggregate", "-1", "--simulator", "lake"), "--aggregate -1"),
        (("--aggregate", "1", "--simulator", "lake", "--log", "x.mcap"), "--log: not with --aggregate"),
        (("--aggregate", "1", "--simulator", "lake", "--force"), "--force: not with --aggregate, which"),
        (("--aggregate", "1", "--simulator", "lake", "--epochs", "0"), "epochs"),
        (("--aggregate", "1", "--viewer", "web"), "--viewer: not with --aggregate, which"),
        (("--aggregate", "1", "--device", "cpu"), "--device: not with --aggregate, which"),
        (("--aggregate", "1", "--car", "torcs.toml"), "it answers 1 where the wheels are to turn by 25"),
    ],
)
def test_what_cannot_be_aggregated_is_one_line(
    aggregated: Aggregated,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    flags: tuple[str, ...],
    expected: str,
) -> None:
    monkeypatch.chdir(aggregated.folder)
    Path("torcs.toml").write_text("max_steering_deg = 23")
    assert call(drive_main, "first", *flags) in (1, 2)
    assert expected in one_line_in(capsys)
