"""The log of a drive: it holds what was decided, never keeps the driving waiting, and a kill costs little."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common import UserError
from drive.control.driver import Decision
from drive.log.drive_log import DriveLog
from recorder import LogWriter
from recorder.bc_pb2 import PilotCommand
from recorder.log.log_time import LogClock
from recorder.log.meant_gaps import MAX_OF_EACH
from recorder.server.eventlet_host import EventletHost
from recorder.server.telemetry import Telemetry
from recorder.server.world import World
from recorder.upkeep.check import check
from recorder.upkeep.recover import recover
from simulator.protocol.client import SimulatorClient
from simulator.protocol.replay import replay
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import PATIENCE_S, DriveProcess, road_jpeg, run, untrained_run
from tests.helpers.logs import read_messages
from tests.helpers.waiting import wait_until

WORLD = World(
    time_s=0.0,
    x_m=12.5,
    y_m=-3.25,
    z_m=1.5,
    heading_rad=0.5,
    pitch_rad=0.0,
    roll_rad=0.0,
    offset=0.1,
    laps=0.25,
    interventions=0,
    expert_steering=-0.125,
    expert_throttle=0.5,
)


def decided(number: int, world: World | None = None, **changed: Any) -> Decision:
    """What a driver might have decided; every number another picture, crop, and command."""
    telemetry = Telemetry(number / 1000, 0.25, 9.0 + number / 100, road_jpeg(number), world=world)
    crop = np.random.default_rng(number).integers(0, 256, (128, 128, 3), np.uint8)
    decision = Decision(
        steering=-number / 500,
        throttle=0.5,
        driver="pilot",
        telemetry=telemetry,
        crop=crop,
        predicted_steering=-number / 400,
        parse_ms=0.125,
        decode_ms=0.25,
        network_ms=1.5,
        set_speed_mph=10.5,
        in_flight=2,
    )
    return replace(decision, **changed)


BAD = Decision(steering=0.0, throttle=0.0, problem="not an object but a list", kind="not an object but a list")


@contextmanager
def drive_log(path: Path) -> Iterator[DriveLog]:
    with LogWriter(path, {"source": "drive"}, live=True) as writer:
        with DriveLog(writer) as log:
            yield log
        assert log.failure is None


def events_of(path: Path) -> list[str]:
    return [event.message for _, event in read_messages(path).get("/events", [])]


# What is in it


def test_a_row_holds_what_was_reported_seen_and_answered(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    decisions = [decided(number) for number in range(30)]
    with drive_log(path) as log:
        for decision in decisions:
            log.decision(decision, total_ms=2.5)
    assert (log.frames, log.dropped_pictures, log.dropped_rows) == (30, 0, 0)
    messages = read_messages(path)
    assert sorted(messages) == ["/camera/center", "/pilot/command", "/pilot/input", "/vehicle"]
    stamps = {topic: [(m.sequence, m.log_time) for m, _ in rows] for topic, rows in messages.items()}
    assert all(rows == stamps["/vehicle"] for rows in stamps.values())
    assert [row for row, _ in stamps["/vehicle"]] == list(range(30))
    for row, decision in enumerate(decisions):
        telemetry = decision.telemetry
        assert telemetry is not None
        assert decision.crop is not None
        assert messages["/camera/center"][row][1].data == telemetry.picture
        crop = cv2.imdecode(np.frombuffer(messages["/pilot/input"][row][1].data, np.uint8), cv2.IMREAD_COLOR)
        assert crop is not None
        assert np.array_equal(crop, decision.crop)
        state = messages["/vehicle"][row][1]
        assert (state.steering, state.throttle, state.brake, state.speed_mph) == (
            *(telemetry.steering, telemetry.throttle),
            *(0.0, telemetry.speed_mph),
        )
        command = messages["/pilot/command"][row][1]
        assert {field.name: value for field, value in command.ListFields() if value} == {
            name: value
            for name, value in {
                "predicted_steering": decision.predicted_steering,
                "steering": decision.steering,
                "throttle": 0.5,
                "driver": PilotCommand.PILOT,
                "set_speed_mph": 10.5,
                "parse_ms": 0.125,
                "decode_ms": 0.25,
                "network_ms": 1.5,
                "total_ms": 2.5,
                "in_flight": 2,
            }.items()
            if value
        }
        assert not command.HasField("expert_steering")


def test_a_reported_world_gives_the_pose_and_what_the_expert_would_do(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    worlds = [replace(WORLD, time_s=i / 25, x_m=i * 0.5, expert_steering=-i / 10) for i in range(5)]
    with drive_log(path) as log:
        for i, world in enumerate(worlds):
            log.decision(decided(i, world, driver="expert" if i == 3 else "pilot"), total_ms=2.0)
    messages = read_messages(path)
    commands = [command for _, command in messages["/pilot/command"]]
    assert [(c.HasField("expert_steering"), c.expert_steering) for c in commands] == [
        (True, world.expert_steering) for world in worlds
    ]
    pilot, expert = PilotCommand.PILOT, PilotCommand.EXPERT
    assert [command.driver for command in commands] == [pilot, pilot, pilot, expert, pilot]
    for (message, pose), world in zip(messages["/pose"], worlds, strict=True):
        place, turn = pose.pose.position, pose.pose.orientation
        assert (place.x, place.y, place.z) == (world.x_m, world.y_m, world.z_m)
        # a turn by the heading about the axis that points up
        assert (turn.w, turn.z, turn.x, turn.y) == pytest.approx((np.cos(0.25), np.sin(0.25), 0.0, 0.0))
        assert pose.timestamp.ToNanoseconds() == message.log_time
    times_ns = [message.log_time for message, _ in messages["/pose"]]
    assert times_ns == [message.log_time for message, _ in messages["/vehicle"]]
    assert np.diff(times_ns).tolist() == [40_000_000] * 4  # the simulated clock, not the time that this test takes


def test_a_healthy_drive_passes_bc_log_check_and_is_one_drive(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with drive_log(path) as log:
        log.event("connected")
        for i in range(40):
            log.decision(decided(i, replace(WORLD, time_s=i / 25)), total_ms=2.0)
            if i == 20:
                log.manual(0.1)
    checked = check(path)
    assert (checked.findings, checked.pictures) == ([], 80)
    info = run("bc-log", "info", path)
    assert "1 drive; no odd rows" in info.stdout


def test_events_of_decisions_stand_in_their_order(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with drive_log(path) as log:
        log.event("connected")
        log.decision(decided(0, events=("lap 1", "the expert takes over: too far")), 2.0)
        log.decision(replace(BAD, events=("nonsense for a second: braking",)), 0.1)
        log.event("disconnected: it went away", is_problem=True)
    events = read_messages(path)["/events"]
    assert [(event.message, event.Level.Name(event.level), event.name) for _, event in events] == [
        ("connected", "INFO", "drive"),
        ("lap 1", "INFO", "drive"),
        ("the expert takes over: too far", "INFO", "drive"),
        ("bad telemetry: not an object but a list", "WARNING", "drive"),
        ("nonsense for a second: braking", "WARNING", "drive"),
        ("disconnected: it went away", "WARNING", "drive"),
    ]
    times_ns = [message.log_time for of_topic in read_messages(path).values() for message, _ in of_topic]
    assert len(set(times_ns)) == len(events) + 1


def test_a_humans_stretch_is_named_at_its_beginning_and_end(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with drive_log(path) as log:
        for number in range(2):
            for _ in range(3):
                log.manual(0.1)
            log.decision(BAD, 0.1)  # says nothing about who drives
            log.manual(0.1)
            log.decision(decided(number), 2.0)
    messages = read_messages(path)
    stretch = ["manual: a human drives", f"bad telemetry: {BAD.problem}", "manual: the pilot drives again"]
    assert events_of(path) == stretch * 2
    ends = [m.log_time for m, e in messages["/events"] if e.message == stretch[2]]
    rows = [m.log_time for m, _ in messages["/vehicle"]]
    assert ends == rows


@pytest.mark.parametrize("is_manual", [True, False])
def test_a_humans_stretch_is_no_gap_whatever_the_simulators_clock(tmp_path: Path, is_manual: bool) -> None:
    """Its clock goes on for five seconds, in which this computer's hardly moves."""
    path = tmp_path / "run.mcap"
    with drive_log(path) as log:
        for number, time_s in enumerate((0.0, 0.1, 5.1, 5.2)):
            if number == 2 and is_manual:
                log.manual(0.1)
            log.decision(decided(number, World(time_s=time_s)), 2.0)
    checked = check(path, look=False)
    where = ["before row 2"]
    assert checked.meant_gaps == (where if is_manual else [])
    assert [finding.where for finding in checked.findings if finding.kind == "gaps in time"] == (
        [] if is_manual else where
    )


def test_ten_thousand_bad_telemetries_are_counted_and_not_all_logged(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    reasons = ["speed is not finite", "image is not base64", "image: no picture"]
    with drive_log(path) as log:
        for number in range(9_000):
            log.decision(replace(BAD, problem=reasons[number % 3], kind=reasons[number % 3]), 0.1)
        for number in range(1_000):  # of a kind, each with its own number
            log.decision(replace(BAD, problem=f"image is cut off ({number} bytes)", kind="image is cut off"), 0.1)
    events = events_of(path)
    assert len(events) == 4 * (MAX_OF_EACH + 1)
    assert f"bad telemetry: image is cut off ({MAX_OF_EACH - 1} bytes)" in events
    assert f"bad telemetry: image is cut off ({1000 - MAX_OF_EACH:,} more)" in events
    for reason in reasons:
        assert events.count(f"bad telemetry: {reason}") == MAX_OF_EACH
        assert f"bad telemetry: {reason} ({3000 - MAX_OF_EACH:,} more)" in events
    more = sum(int(event.rpartition("(")[2].split()[0].replace(",", "")) for event in events if "more)" in event)
    assert more + sum("more)" not in event for event in events) == 10_000
    assert log.frames == 0


# Its times

moments = st.one_of(
    st.just("event"),
    st.none(),  # a row of a simulator that tells no clock
    st.floats(0, 1e9),
    st.integers(0, 50).map(lambda step: step / 50),
)


@given(st.lists(st.tuples(st.integers(0, 3 * 10**7), moments), max_size=30))  # in under a second, no clock stands
def test_no_time_is_the_same_or_back_and_simulated_time_is_kept(received: list[tuple[int, Any]]) -> None:
    clock = LogClock()
    received_ns, last_ns = 0, 0
    last_row: tuple[int, float | None] | None = None
    for passed_ns, moment in received:
        received_ns += passed_ns
        time_ns = clock.event(received_ns) if moment == "event" else clock.row(received_ns, moment)
        assert time_ns > last_ns
        if moment != "event":
            if last_row is not None:
                before_ns, before = last_row
                if (
                    moment is not None
                    and before is not None
                    and 0 <= round(moment * 1e9) - round(before * 1e9) <= 60e9
                ):
                    # to the nanosecond, but for rows and events of the very same moment
                    late_ns = time_ns - before_ns - (round(moment * 1e9) - round(before * 1e9))
                    assert abs(late_ns) <= len(received)
                elif moment is not None or before is not None:
                    assert time_ns - before_ns > 1e9  # another clock: a break, as between two drives
            last_row = time_ns, moment
        last_ns = time_ns


def test_a_clock_that_jumps_moves_the_log_by_seconds_not_years() -> None:
    clock = LogClock()
    first_ns, *_, last_ns = (clock.row(row, 1e9 * (row % 2)) for row in range(40))
    assert last_ns - first_ns < 40 * 2e9


@pytest.mark.parametrize("step_s", [0.0, -0.1])
def test_rows_of_a_standing_simulated_clock_have_their_receipt_time(step_s: float) -> None:
    clock = LogClock()
    times_ns = [clock.row(row * 50_000_000, 9 + row * step_s) for row in range(60)]
    assert clock.stands
    assert times_ns[-1] - times_ns[-31] == 30 * 50_000_000


# A slow disk


@contextmanager
def standing_disk(writer: LogWriter, monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Event]:
    """Nothing is written until the event is set."""
    goes_on = threading.Event()
    write = writer.vehicle

    def vehicle(*arguments: Any) -> None:
        assert goes_on.wait(PATIENCE_S)
        write(*arguments)

    monkeypatch.setattr(writer, "vehicle", vehicle)
    yield goes_on
    goes_on.set()


def test_where_the_disk_stands_still_pictures_are_lost_before_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"
    decisions = [decided(i, replace(WORLD, time_s=i / 25)) for i in range(100)]
    sizes = [len(d.telemetry.picture) + d.crop.nbytes for d in decisions if d.telemetry and d.crop is not None]
    kept = 7
    monkeypatch.setattr("drive.log.drive_log.MAX_PICTURE_BYTES", sum(sizes[:kept]))
    with LogWriter(path, {"source": "drive"}, live=True) as writer, standing_disk(writer, monkeypatch) as goes_on:
        log = DriveLog(writer)
        for decision in decisions:  # would never end if anything waited
            log.decision(decision, 2.0)
        assert (log.frames, log.dropped_pictures, log.dropped_rows) == (100, 2 * (100 - kept), 0)
        goes_on.set()
        log.close()
    messages = read_messages(path)
    counts = {topic: len(of_topic) for topic, of_topic in messages.items() if topic != "/events"}
    assert counts == {
        **dict.fromkeys(("/vehicle", "/pilot/command", "/pose"), 100),
        **dict.fromkeys(("/camera/center", "/pilot/input"), kept),
    }
    commands = [command for _, command in messages["/pilot/command"]]
    assert [command.steering for command in commands] == [decision.steering for decision in decisions]
    first, last = events_of(path)
    assert "pictures are left out" in first
    assert f"{2 * (100 - kept)} pictures are missing" in last
    assert {finding.kind for finding in check(path).findings} == {"stretches of rows without a picture"}


def test_pictures_come_back_when_the_disk_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.mcap"
    monkeypatch.setattr("drive.log.drive_log.MAX_PICTURE_BYTES", 100_000)
    with LogWriter(path, {"source": "drive"}, live=True) as writer, standing_disk(writer, monkeypatch) as goes_on:
        log = DriveLog(writer)
        for number in range(10):
            log.decision(decided(number), 2.0)
        dropped = log.dropped_pictures
        assert dropped > 0
        goes_on.set()
        for number in range(10, 2000):
            log.decision(decided(number), 2.0)
            if log.dropped_pictures < 2 * (number - 5):
                break
        log.close()
    rows = [message.sequence for message, _ in read_messages(path)["/camera/center"]]
    assert rows[0] == 0
    assert rows[-1] >= 10


def test_rows_are_lost_only_when_far_more_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.mcap"
    monkeypatch.setattr("drive.log.drive_log.MAX_WAITING", 20)
    with LogWriter(path, {"source": "drive"}, live=True) as writer, standing_disk(writer, monkeypatch) as goes_on:
        log = DriveLog(writer)
        for number in range(50):
            log.decision(decided(number), 2.0)
            log.event(f"event {number}")
        assert (log.frames, log.dropped_rows) == (10, 80)
        goes_on.set()
        log.close()
    assert [message.sequence for message, _ in read_messages(path)["/vehicle"]] == list(range(10))
    events = events_of(path)
    assert events[:10] == [f"event {number}" for number in range(10)]
    assert ["rows are left out" in events[10], "80 rows and events are missing" in events[11]] == [True, True]


def test_a_full_disk_is_reported_and_the_driving_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recorder.log.writer.FLUSH_S", 0.0)  # a second of driving is written in no time here
    path = tmp_path / "run.mcap"
    writer = LogWriter(path, {"source": "drive"}, live=True)
    with files_of_at_most(1_000_000), DriveLog(writer) as log:
        for number in range(2000):  # 20 fit
            log.decision(decided(number), 2.0)
            if log.failure is not None:
                break
        frames = log.frames
        for number in range(5):
            log.decision(decided(number), 2.0)
            log.manual(0.1)
            log.event("nobody reads it")
    assert isinstance(log.failure, UserError)
    assert str(writer.part) in str(log.failure)
    assert "bc-log recover" in str(log.failure)
    assert log.frames == frames
    writer.__exit__(type(log.failure), log.failure, None)
    recovered = recover(writer.part, tmp_path / "recovered.mcap").path
    rows = [message.sequence for message, _ in read_messages(recovered)["/vehicle"]]
    assert len(rows) > 5
    assert rows == list(range(len(rows)))


# Its thread


def test_it_is_written_while_the_driving_loop_waits_in_eventlet(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    host = EventletHost("127.0.0.1", 0, lambda problem: None)
    host.start(lambda environ, start_response: [])
    with LogWriter(path, {"source": "drive"}, live=True) as writer, DriveLog(writer) as log:
        begin = writer.bytes_written
        for number in range(20):
            log.decision(decided(number), 2.0)
        while writer.bytes_written < begin + 256 * 1024:
            host.wait(0.001)
    host.end()
    assert len(read_messages(path)["/vehicle"]) == 20


def test_what_was_handed_over_last_reaches_the_file_without_anything_more(tmp_path: Path) -> None:
    """While the simulator stands still, say."""
    with LogWriter(tmp_path / "run.mcap", {"source": "drive"}, live=True) as writer, DriveLog(writer) as log:
        log.decision(decided(0), 2.0)
        until_s = time.monotonic() + PATIENCE_S
        while road_jpeg(0) not in writer.part.read_bytes():
            assert time.monotonic() < until_s


# Its viewer


def test_a_viewer_that_is_stopped_keeps_neither_the_drive_nor_its_log(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    viewer = "import time; time.sleep(1000)"
    with DriveProcess(untrained_run(tmp_path / "run"), path, "--viewer", "web", viewer=viewer) as process:
        port = process.wait_until_it_listens()
        children = Path(f"/proc/{process.popen.pid}/task/{process.popen.pid}/children")
        if not children.exists():
            pytest.skip("a stopped viewer was not tried: this system does not list a process's children")
        (child,) = map(int, children.read_text().split())

        def is_stopped() -> bool:
            return Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[0] == "T"

        os.kill(child, signal.SIGSTOP)
        wait_until(is_stopped)  # on a busy machine, the signal waits for the child's turn
        replay(SimulatorClient(port=port), [road_jpeg(number % 50) for number in range(300)])
        assert is_stopped()
        assert process.end() == 0
    assert not Path(f"/proc/{child}").exists()
    assert len(read_messages(path)["/camera/center"]) == 300
