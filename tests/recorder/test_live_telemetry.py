"""Live telemetry becomes a log: what was told is in it, whoever told it; what could not be used is counted."""

from __future__ import annotations

import base64
import itertools
import math
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import pytest

from common import UserError
from recorder import Imported, RecordingError
from recorder.sources.live_telemetry import listen_for_telemetry
from recorder.sources.settings import ListenSettings
from simulator.protocol.client import (
    ServerCommand,
    SimulatorClient,
    SimulatorMessage,
    SimulatorTelemetry,
    WaitTimeoutError,
)
from tests.helpers.driving import PATIENCE_S, Process, road_jpeg
from tests.helpers.logs import START_NS, read_messages
from tests.helpers.serving import ModernClient, RawClient

# `bc-record listen` without its flags: the log, the port, and where given the seconds of waiting.
LISTEN = """
import sys
from dataclasses import dataclass
from pathlib import Path
from common.command import run_command, warn_skipped
from recorder.server import telemetry_server
from recorder.sources.settings import ListenSettings
from recorder.sources.live_telemetry import listen_for_telemetry

telemetry_server.FIRST_COMMAND_S = 300  # a client that is kept waiting by others is sent nothing unasked

@dataclass
class Listen:
    log: Path
    port: int = 0
    idle: float | None = None

def listen(config):
    done = listen_for_telemetry(config.log, ListenSettings(port=config.port, idle_s=config.idle))
    print(done.path, done.rows, done.pictures, flush=True)
    return warn_skipped(done.skipped)

run_command("listen", Listen, listen)
"""
DRIVEN = [
    SimulatorTelemetry(steering=i / 20 - 1, throttle=i / 40, speed_mph=i / 4, jpeg=road_jpeg(i)) for i in range(40)
]


def with_a_small_disk(line: list[str]) -> list[str]:
    """The command line, run where no file may grow above 400 blocks: refused by the system as on a full disk."""
    return ["sh", "-c", 'ulimit -f 400; exec "$0" "$@"', *line]


def listening(log: Path, *flags: object) -> list[str]:
    return [sys.executable, "-c", LISTEN, "--log", str(log), *map(str, flags)]


class ListenProcess(Process):
    """A process that listens on a free port."""

    def __init__(self, log: Path, *flags: object) -> None:
        self.log = log
        super().__init__(listening(log, *flags))

    def wait_until_it_listens(self) -> int:
        """Its port."""
        return int(self.wait_for(r"^waiting for a simulator on 127\.0\.0\.1:(\d+)$")[1])


def fields(telemetry: SimulatorTelemetry, **changed: Any) -> dict[str, Any]:
    """A telemetry as JSON, for clients that are not ours; ... leaves a field out."""
    values = {
        "steering_angle": f"{telemetry.steering * 25:.4f}",
        "throttle": f"{telemetry.throttle:.4f}",
        "speed": f"{telemetry.speed_mph:.4f}",
        "image": base64.b64encode(telemetry.jpeg).decode(),
    }
    return {name: value for name, value in {**values, **changed}.items() if value is not ...}


BAD: dict[str, tuple[Any, str]] = {
    "a picture cut off": (
        fields(DRIVEN[0], image=base64.b64encode(road_jpeg(0)[:-200]).decode()),
        "image is a JPEG that is cut off or damaged",
    ),
    "no picture": (fields(DRIVEN[0], image=...), "image is missing"),
    "not base64": (fields(DRIVEN[0], image="%%%%"), "image is not base64"),
    "a speed in words": (fields(DRIVEN[0], speed="fast"), "speed is not a number (fast)"),
    "a list": ([1, 2], "not an object but a list"),
}


def tell(
    port: int, telemetries: Sequence[SimulatorTelemetry | Literal["manual"]], host: str = "127.0.0.1"
) -> list[ServerCommand]:
    """The simulator's own client tells them all, each when the last is answered; the answers."""
    answers: list[ServerCommand] = []
    left: Iterator[SimulatorMessage] = iter(telemetries)

    def next_telemetry(answer: ServerCommand) -> SimulatorMessage:
        if answer is not None:
            answers.append(answer)
        return next(left, None if len(answers) == len(telemetries) else "nothing")

    SimulatorClient(host, port, wait_s=PATIENCE_S).run(next_telemetry)
    return answers


@dataclass
class Listened:
    """What was told to one listening process, how it was answered, and what it left."""

    log: Path
    began_ns: int = 0
    ended_ns: int = 0
    old: list[ServerCommand] = field(default_factory=list)
    modern: list[Any] = field(default_factory=list)
    bad: dict[str, Any] = field(default_factory=dict)
    comma: list[Any] = field(default_factory=list)
    manual: list[ServerCommand] = field(default_factory=list)
    exit_code: int = -1
    stdout: str = ""
    stderr: list[str] = field(default_factory=list)
    names: list[str] = field(default_factory=list)

    @property
    def rows(self) -> list[SimulatorTelemetry]:
        """What must be in the log, in this order."""
        return [*DRIVEN, *DRIVEN[:5], *[DRIVEN[7]] * len(BAD), *DRIVEN[8:12], DRIVEN[3]]


@pytest.fixture(scope="module")
def listened(tmp_path_factory: pytest.TempPathFactory) -> Listened:
    folder = tmp_path_factory.mktemp("listen")
    done = Listened(folder / "live.mcap", began_ns=time.time_ns())
    with ListenProcess(done.log) as process:
        port = process.wait_until_it_listens()
        done.old = tell(port, DRIVEN)
        modern = ModernClient(port)
        done.modern = [modern.tell(fields(telemetry)) for telemetry in DRIVEN[:5]]
        for name, (data, _) in BAD.items():
            done.bad[name] = modern.tell(data)
            done.modern.append(modern.tell(fields(DRIVEN[7])))
        modern.close()

        def comma(text: str) -> str:
            return text.replace(".", ",")

        modern = ModernClient(port)
        for telemetry in DRIVEN[8:12]:
            values = fields(telemetry)
            done.comma.append(modern.tell({k: v if k == "image" else comma(v) for k, v in values.items()}))
        modern.close()
        done.manual = tell(port, ["manual", DRIVEN[3], "manual"])
        done.names = [path.name for path in folder.iterdir()]
        done.exit_code = process.end(signal.SIGINT)
        done.ended_ns = time.time_ns()
        done.stdout, done.stderr = process.stdout, process.stderr
    return done


def test_every_telemetry_is_answered_by_manual_whoever_reported_it(listened: Listened) -> None:
    assert listened.old == ["manual"] * len(DRIVEN)
    assert listened.manual == ["manual"] * 3
    assert listened.modern == [("manual", {})] * (5 + len(BAD))
    assert list(listened.bad.values()) == [("manual", {})] * len(BAD)


def test_the_pictures_are_in_the_log_byte_for_byte(listened: Listened) -> None:
    pictures = [decoded for _, decoded in read_messages(listened.log)["/camera/center"]]
    assert [picture.data for picture in pictures] == [telemetry.jpeg for telemetry in listened.rows]
    assert {picture.format for picture in pictures} == {"jpeg"}


def test_the_vehicle_is_as_reported_with_steering_in_shares_of_25_degrees(listened: Listened) -> None:
    states = [decoded for _, decoded in read_messages(listened.log)["/vehicle"]]
    for state, telemetry in zip(states, listened.rows, strict=True):
        assert state.steering == pytest.approx(telemetry.steering, abs=1e-4 / 25)
        assert state.throttle == pytest.approx(telemetry.throttle, abs=1e-4)
        assert state.speed_mph == pytest.approx(telemetry.speed_mph, abs=1e-4)
        assert state.brake == 0


def test_a_frame_has_one_time_and_number_and_times_only_grow(listened: Listened) -> None:
    messages = read_messages(listened.log)
    stamps = [
        [(message.sequence, message.log_time) for message, _ in messages[topic]]
        for topic in ("/camera/center", "/vehicle")
    ]
    assert stamps[0] == stamps[1]
    assert [sequence for sequence, _ in stamps[0]] == list(range(len(listened.rows)))
    times_ns = [time_ns for _, time_ns in stamps[0]]
    assert times_ns == sorted(set(times_ns))
    assert listened.began_ns < times_ns[0] < times_ns[-1] < listened.ended_ns  # the times of receipt


def test_what_cannot_be_used_is_an_event_with_its_reason_and_is_counted(listened: Listened) -> None:
    events = [decoded for _, decoded in read_messages(listened.log)["/events"]]
    bad = [event.message for event in events if event.message.startswith("bad telemetry: ")]
    assert len(bad) == len(BAD)
    for message, (_, reason) in zip(bad, BAD.values(), strict=True):
        assert reason in message
    skipped = [line for line in listened.stderr if line.startswith("skipped ")]
    assert len(skipped) == len(BAD)
    for line, (_, reason) in zip(skipped, BAD.values(), strict=True):
        kind = reason.partition(" (")[0]
        assert re.fullmatch(rf"skipped telemetries that cannot be used \(.*{re.escape(kind)}.*\): 1 \(.*\)", line)


def test_who_came_and_went_is_in_the_log(listened: Listened) -> None:
    events = [decoded.message for _, decoded in read_messages(listened.log)["/events"]]
    assert events.count("connected") == 4
    assert sum(event.startswith("disconnected: ") for event in events) == 4
    manual = [event for event in events if event.startswith("manual: ")]
    assert manual == ["manual: a human drives", "manual: telemetry comes again", "manual: a human drives"]


def test_ctrl_c_finishes_the_log_under_its_name(listened: Listened) -> None:
    (part,) = listened.names
    assert part.startswith("live.mcap.")
    assert part.endswith(".part")
    assert list(listened.log.parent.iterdir()) == [listened.log]
    assert listened.exit_code == 3  # done, but the bad ones were skipped
    assert listened.stdout == f"{listened.log} {len(listened.rows)} {len(listened.rows)}\n"


def test_without_a_terminal_waiting_and_connected_are_said_once(listened: Listened) -> None:
    printed = [line for line in listened.stderr if not line.startswith("skipped ")]
    bad = [line for line in printed if line.startswith("telemetry that cannot be used: ")]
    assert len(bad) == len(BAD)  # each is the first of its kind
    assert all(reason in line for line, (_, reason) in zip(bad, BAD.values(), strict=True))
    assert [line for line in printed if line not in bad][1:] == ["connected, waiting for telemetry"]


def test_a_kind_of_bad_telemetry_is_said_once_and_fills_no_log(tmp_path: Path) -> None:
    """Its events are few, and its number is told by them, however many lengths the pictures had."""
    count = 40
    with ListenProcess(tmp_path / "live.mcap") as process:
        port = process.wait_until_it_listens()
        cut = [SimulatorTelemetry(0.0, 0.0, 9.0, road_jpeg(0)[: -200 - i]) for i in range(count)]
        tell(port, [DRIVEN[0], *cut])
        assert process.end() == 3
    assert sum("telemetry that cannot be used" in line for line in process.stderr) == 1
    events = [decoded.message for _, decoded in read_messages(tmp_path / "live.mcap")["/events"]]
    bad = [event for event in events if event.startswith("bad telemetry: ")]
    assert len(bad) == 6
    assert bad[-1].endswith("(35 more)")


def test_two_simulators_at_once_have_a_log_each_and_kill_finishes_both(tmp_path: Path) -> None:
    log, second_log = tmp_path / "live.mcap", tmp_path / "live-2.mcap"
    with ListenProcess(log) as process:
        port = process.wait_until_it_listens()
        first, second = ModernClient(port), RawClient(port)
        for telemetry, other in zip(DRIVEN[:10], DRIVEN[10:20], strict=True):
            first.tell(fields(telemetry))
            second.tell(fields(other))
            assert second.command() == ("manual", {})
        second.websocket.send("1")
        second.until_hung_up()
        first.tell(fields(DRIVEN[20]))
        again = ModernClient(port)  # as one that was closed and started again: its log continues
        again.tell(fields(DRIVEN[21]))
        for client in (first, again):
            client.close()
        assert process.end(signal.SIGTERM) == 0
    for path, driven in ((log, [*DRIVEN[:10], DRIVEN[20]]), (second_log, [*DRIVEN[10:20], DRIVEN[21]])):
        frames = read_messages(path)["/camera/center"]
        assert [decoded.data for _, decoded in frames] == [telemetry.jpeg for telemetry in driven]
    assert process.stdout == f"{log} 11 11\n"
    assert sum("a second simulator" in line and str(second_log) in line for line in process.stderr) == 1


def listen_here(
    log: Path,
    capsys: pytest.CaptureFixture[str],
    send: Callable[[int], object],
    *,
    idle_s: float | None = None,
    overwrite: bool = False,
) -> Imported:
    """Listen in this process, while `told(port)` runs in a thread of its own."""
    threads = []

    def on_started(growing: Path) -> None:
        assert growing.is_file()
        assert growing.name.startswith(log.name + ".")
        port = int(capsys.readouterr().err.splitlines()[0].rpartition(":")[2])
        threads.append(threading.Thread(target=send, args=(port,)))
        threads[0].start()

    try:
        settings = ListenSettings(port=0, idle_s=idle_s, on_started=on_started)
        return listen_for_telemetry(log, settings, overwrite=overwrite)
    finally:
        threads[0].join(PATIENCE_S)
        assert not threads[0].is_alive()


def test_it_ends_when_nothing_more_comes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "live.mcap"
    before = signal.getsignal(signal.SIGINT)
    done = listen_here(log, capsys, lambda port: tell(port, DRIVEN[:1]), idle_s=0.1)
    assert (done.path, done.rows, done.pictures, len(done.skipped)) == (log, 1, 1, 0)
    assert len(read_messages(log)["/camera/center"]) == 1
    assert signal.getsignal(signal.SIGINT) is before


def test_a_simulator_that_sends_its_clock_and_place_is_recorded_by_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ten simulated seconds in however little time; what of its world cannot be used is said once."""
    pose = {"x_m": 1.0, "y_m": 2.0, "z_m": 0.0, "heading_rad": 0.0, "pitch_rad": 0.0, "roll_rad": 0.0}
    telemetries = [replace(DRIVEN[i], world={"time_s": i / 4, **pose, "laps": math.inf}) for i in range(40)]

    def tell_all(port: int) -> None:
        try:
            tell(port, telemetries)
        finally:
            signal.raise_signal(signal.SIGINT)  # heard by the main thread, which listens

    listen_here(tmp_path / "live.mcap", capsys, tell_all)
    messages = read_messages(tmp_path / "live.mcap")
    times_ns = [message.log_time for message, _ in messages["/vehicle"]]
    assert [time_ns - times_ns[0] for time_ns in times_ns] == [round(i / 4 * 1e9) for i in range(40)]
    assert [message.log_time for message, _ in messages["/pose"]] == times_ns
    assert messages["/pose"][0][1].pose.position.y == 2.0
    events = [event.message for _, event in messages["/events"] if "world" in event.message]
    assert events == ["the simulator's world is not used whole: laps is beyond 1e+09, or no number"]


@pytest.mark.parametrize("step_h", [-1, 1])
def test_a_clock_that_is_set_moves_no_row(
    step_h: int, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is set between any two readings, and the rows lie as far apart as by a clock that nobody can set."""
    clock = itertools.count(START_NS, step_h * 3600 * 10**9)
    monkeypatch.setattr(time, "time_ns", lambda: next(clock))
    passed_s = []

    def tell_and_stop(port: int) -> None:
        start_s = time.monotonic()
        tell(port, DRIVEN[:5])
        passed_s.append(time.monotonic() - start_s)
        signal.raise_signal(signal.SIGINT)

    listen_here(tmp_path / "live.mcap", capsys, tell_and_stop)
    messages = read_messages(tmp_path / "live.mcap")
    times_ns = [message.log_time for message, _ in messages["/vehicle"]]
    assert len(times_ns) == 5
    steps_ns = [later - earlier for earlier, later in itertools.pairwise(times_ns)]
    assert min(steps_ns) > 1000  # no two telemetries come within a microsecond
    assert sum(steps_ns) / 1e9 < passed_s[0]
    assert abs(messages["/events"][0][0].log_time - START_NS) < 10**15


@pytest.mark.parametrize(
    ("telemetries", "advice"),
    [
        (["manual"], "--watch"),
        ([SimulatorTelemetry(0.0, 0.0, 9.0, b"no picture")], "image is not a JPEG"),
    ],
    ids=["a human drove", "no picture was one"],
)
def test_nothing_that_can_be_used_is_an_error_and_leaves_no_file(
    telemetries: list[Any], advice: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(RecordingError, match=advice):
        listen_here(tmp_path / "live.mcap", capsys, lambda port: tell(port, telemetries), idle_s=0.1)
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_before_anybody_came_reports_what_to_do_and_leaves_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(RecordingError, match="autonomous mode"):
        listen_here(tmp_path / "live.mcap", capsys, lambda port: signal.raise_signal(signal.SIGINT))
    assert capsys.readouterr().err == ""
    assert list(tmp_path.iterdir()) == []


def test_an_existing_log_is_refused_before_anybody_can_connect(tmp_path: Path) -> None:
    log = tmp_path / "live.mcap"
    log.write_bytes(b"precious")
    with pytest.raises(UserError, match="--force"):
        listen_for_telemetry(log, ListenSettings(port=0))
    assert (log.read_bytes(), list(tmp_path.iterdir())) == (b"precious", [log])


def test_a_full_disk_ends_the_recording_in_one_line_that_names_the_file(tmp_path: Path) -> None:
    log = tmp_path / "live.mcap"
    with Process(with_a_small_disk(listening(log))) as process:
        port = int(process.wait_for(r"^waiting for a simulator on 127\.0\.0\.1:(\d+)$")[1])
        with pytest.raises(WaitTimeoutError):  # it tells on and on, until nobody is there any more
            SimulatorClient(port=port, wait_s=0).run(lambda answer: DRIVEN[0])
        assert process.join() == 1
        error = process.stderr[-1]
        assert len(process.stderr) == 3, process.stderr  # the others: waiting, connected
    (part,) = tmp_path.iterdir()
    assert part.suffix == ".part"
    assert str(part) in error
    assert "File too large" in error
