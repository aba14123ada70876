"""One `bc-drive` serves old and modern clients: every telemetry is answered, and the log holds what happened."""

from __future__ import annotations

import base64
import contextlib
import io
import signal
import threading
import time
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
import websocket
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Log_pb2 import Log as LogMessage
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader

from dataset import decode
from drive.cli import drive as drive_command
from drive.cli import main as drive_main
from drive.config import DriveConfig
from drive.drive_flags import Drive as DriveCommand
from drive.drive_server import MAX_SIMULATORS, DriveServer
from model import load_pilot
from recorder import Log
from recorder.bc_pb2 import PilotCommand
from recorder.server.telemetry import MAX_IMAGE_BYTES
from recorder.upkeep.recover import recover, recovered_name
from simulator.protocol.client import (
    ServerCommand,
    SimulatorClient,
    SimulatorMessage,
    SimulatorTelemetry,
    SteerCommand,
    WaitTimeoutError,
)
from simulator.protocol.replay import replay
from tests.helpers.driving import (
    PATIENCE_S,
    DriveProcess,
    Process,
    command_after,
    one_line_in,
    one_line_of,
    road_jpeg,
    run,
    untrained_run,
)
from tests.helpers.logs import read_messages
from tests.helpers.ports import free_ports
from tests.helpers.rrd import contents
from tests.helpers.serving import ModernClient, RawClient, fields
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until

REPLAYED, MODERN, TOGETHER, COMMA, MANUAL = 60, 12, 15, 10, 3
TOPICS = ("/camera/center", "/vehicle", "/pilot/input", "/pilot/command")


MALFORMED: dict[str, Any] = {
    "a list": [1, 2],
    "empty": {},
    "no image": fields(0, image=...),
    "an image that is not base64": fields(0, image="%%%%"),
    "an image that is not a picture": fields(0, image="AAAA"),
    "too large an image": fields(0, image="A" * (MAX_IMAGE_BYTES + 4)),
    "a speed of nan": fields(0, speed="nan"),
    "a speed in words": fields(0, speed="fast"),
    "a throttle that is null": fields(0, throttle=None),
}
BROKEN_JSON = ('42["telemetry",{"speed":', '42["telemetry",' + "[" * 100_000)
MALFORMED_NAMES = [*MALFORMED, *(text[-9:] for text in BROKEN_JSON)]


def answer_to(client: RawClient, data: object) -> tuple[str, Any]:
    """Tell one telemetry; the event that answers it, and what it holds."""
    client.tell(data)
    return client.command()


@dataclass
class Drive:
    """What happened in one server's life, and the log that it left."""

    run: Path
    pictures: list[bytes]
    client: SimulatorClient
    commands: list[SteerCommand]
    modern: list[dict[str, Any]] = field(default_factory=list)
    together: tuple[list[SteerCommand], list[dict[str, Any]]] = field(default_factory=lambda: ([], []))
    malformed: dict[str, tuple[str, Any]] = field(default_factory=dict)
    between: list[tuple[str, Any]] = field(default_factory=list)
    manual: list[ServerCommand] = field(default_factory=list)
    comma_client: SimulatorClient | None = None
    comma: list[SteerCommand] = field(default_factory=list)
    comma_wire: tuple[str, Any] = ("", None)
    second: str = ""
    exit_code: int = -1
    stdout: str = ""
    stderr: str = ""
    log: Path = Path()

    @property
    def frames(self) -> int:
        """Those that were driven on, of all scenarios, but for the second simulator's."""
        return REPLAYED + MODERN + TOGETHER + len(self.between) + MANUAL + COMMA + 1

    @property
    def second_log(self) -> Path:
        return self.log.with_name("run-2.mcap")


def drive_manually(port: int) -> list[ServerCommand]:
    """Tells "manual", a telemetry, "manual", ... and keeps the answers."""
    answers: list[ServerCommand] = []
    telemetries: Iterator[SimulatorMessage] = iter(
        message for i in range(MANUAL) for message in ("manual", SimulatorTelemetry(0.0, 0.0, 5.0, road_jpeg(i)))
    )

    def next_telemetry(answer: ServerCommand) -> SimulatorMessage:
        if answer is not None:
            answers.append(answer)
        return next(telemetries, None if len(answers) == 2 * MANUAL else "nothing")

    SimulatorClient(port=port).run(next_telemetry)
    return answers


@pytest.fixture(scope="module")
def pilot_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return untrained_run(tmp_path_factory.mktemp("runs") / "untrained", seed=3)


@pytest.fixture(scope="module")
def drive(pilot_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    folder = tmp_path_factory.mktemp("drive")
    log = folder / "run.mcap"
    with DriveProcess(pilot_run, log) as server:
        port = server.wait_until_it_listens()

        client = SimulatorClient(port=port, wait_s=PATIENCE_S)
        pictures = [road_jpeg(i) for i in range(REPLAYED)]
        done = Drive(pilot_run, pictures, client, replay(client, pictures))

        modern = ModernClient(port)
        done.modern = [modern.tell(fields(i))[1] for i in range(MODERN)]

        old_commands: list[SteerCommand] = []
        old = threading.Thread(
            target=lambda: old_commands.extend(
                replay(SimulatorClient(port=port), [road_jpeg(i) for i in range(TOGETHER)])
            )
        )
        old.start()
        modern_answers = [modern.tell(fields(i))[1] for i in range(TOGETHER)]
        old.join(PATIENCE_S)
        done.together = (old_commands, modern_answers)
        modern.close()

        bare = RawClient(port)
        for name, data in MALFORMED.items():
            done.between.append(answer_to(bare, fields(len(done.between))))
            done.malformed[name] = answer_to(bare, data)
        for text in BROKEN_JSON:
            done.between.append(answer_to(bare, fields(len(done.between))))
            bare.websocket.send(text)
            done.malformed[text[-9:]] = bare.command()
        bare.close()

        done.manual = drive_manually(port)

        done.comma_client = SimulatorClient(port=port, decimal_comma=True)
        done.comma = replay(done.comma_client, [road_jpeg(i) for i in range(COMMA)], speed_mph=1234.5)
        bare = RawClient(port)
        done.comma_wire = answer_to(bare, fields(0, throttle="0,1000", speed="9,0000", steering_angle="0,0000"))
        bare.close()

        with contextlib.redirect_stderr(io.StringIO()) as refused:
            assert call(drive_main, pilot_run, "--log", folder / "second.mcap", "--port", port) == 1
        (done.second,) = refused.getvalue().splitlines()

        assert not log.exists()
        done.exit_code = server.end(signal.SIGINT)
        done.stdout, done.stderr = server.stdout, "\n".join(server.stderr)
    done.log = log
    return done


def decoded(path: Path, topic: str) -> list[Any]:
    """What the messages of a topic hold: by mcap's own reader, not by ours."""
    return [content for _, content in read_messages(path).get(topic, [])]


def images(path: Path, topic: str) -> list[bytes]:
    return [image.data for image in decoded(path, topic)]


def events(path: Path) -> list[str]:
    return [event.message for event in decoded(path, "/events")]


def test_every_picture_is_answered_and_none_is_lost(drive: Drive) -> None:
    assert drive.client.telemetries == drive.client.steers == len(drive.commands) == REPLAYED
    assert (drive.client.bad_steers, drive.client.connections) == (0, 1)
    assert len({command.steering for command in drive.commands}) > REPLAYED // 2  # the network really looked


def test_the_log_holds_frame_crop_command_and_state_of_each_telemetry(drive: Drive) -> None:
    messages = read_messages(drive.log)
    stamps = [[(message.sequence, message.log_time) for message, _ in messages[topic]] for topic in TOPICS]
    assert stamps[0] == stamps[1] == stamps[2] == stamps[3]
    assert [sequence for sequence, _ in stamps[0]] == list(range(drive.frames))
    times_ns = [time_ns for _, time_ns in stamps[0]]
    assert times_ns == sorted(set(times_ns))


def test_the_logged_pictures_are_those_that_were_reported_byte_for_byte(drive: Drive) -> None:
    assert images(drive.log, "/camera/center")[:REPLAYED] == drive.pictures


def test_the_logged_prediction_fits_the_logged_frame_and_crop(drive: Drive) -> None:
    torch.set_num_threads(1)  # as in the server
    pilot = load_pilot(drive.run)
    commands = decoded(drive.log, "/pilot/command")
    frames, crops = images(drive.log, "/camera/center"), images(drive.log, "/pilot/input")
    for frame, crop, command in zip(frames[:REPLAYED], crops[:REPLAYED], commands[:REPLAYED], strict=True):
        assert pilot.predict(pilot.crop(decode(frame))) == command.predicted_steering
        assert crop.startswith(b"\x89PNG")
        assert pilot.predict(decode(crop)) == command.predicted_steering


def test_the_logged_command_is_the_one_that_the_simulator_got(drive: Drive) -> None:
    commands = decoded(drive.log, "/pilot/command")[:REPLAYED]
    for sent, got in zip(commands, drive.commands, strict=True):
        assert got.steering == pytest.approx(sent.steering, abs=1e-6)
        assert got.throttle == pytest.approx(sent.throttle, abs=1e-6)
        assert sent.steering == min(max(sent.predicted_steering, -1.0), 1.0)
        assert (sent.driver, sent.set_speed_mph) == (PilotCommand.PILOT, 10.0)
        assert 0 < sent.decode_ms + sent.network_ms <= sent.total_ms


def test_the_logged_state_is_what_the_simulator_reported(drive: Drive) -> None:
    states = decoded(drive.log, "/vehicle")[:REPLAYED]
    assert {state.speed_mph for state in states} == {9.0}
    # The first two telemetries leave before any answer; from then on each tells the command last got.
    commands = [(0.0, 0.0)] * 2 + [(command.steering, command.throttle) for command in drive.commands]
    for state, (steering, throttle) in zip(states, commands[:REPLAYED], strict=True):
        assert state.steering == pytest.approx(min(max(steering, -1.0), 1.0), abs=1e-4 / 25)
        assert state.throttle == pytest.approx(max(throttle, 0.0), abs=1e-4)


def test_a_modern_client_gets_the_same_commands(drive: Drive) -> None:
    assert [float(answer["steering_angle"]) for answer in drive.modern] == pytest.approx(
        [command.steering for command in drive.commands[:MODERN]], abs=1e-6
    )
    for answer in drive.modern:
        assert set(answer) == {"steering_angle", "throttle"}
        assert all(isinstance(value, str) for value in answer.values())


def test_a_second_simulator_has_a_log_of_its_own_and_that_is_said(drive: Drive) -> None:
    assert images(drive.second_log, "/camera/center") == drive.pictures[:TOGETHER]
    rows = read_messages(drive.second_log)["/vehicle"]
    assert [message.sequence for message, _ in rows] == list(range(TOGETHER))
    (printed,) = [line for line in drive.stderr.splitlines() if "second simulator" in line]
    assert str(drive.second_log) in printed
    assert f"{drive.second_log}: {TOGETHER} frames" in drive.stdout


def test_so_many_simulators_are_driven_at_once_and_no_more(pilot_run: Path, tmp_path: Path) -> None:
    printed: list[str] = []
    pilot, log = load_pilot(pilot_run), tmp_path / "run.mcap"
    names = [str(number) for number in range(MAX_SIMULATORS + 2)]
    with DriveServer(pilot, DriveConfig(), log, port=0, notify=printed.append) as server:
        for name in names:
            server.connected(name)
        answers = [server.telemetry(name, fields(0), time.perf_counter()) for name in names]
        for answer in answers:
            answer.on_sent(1.0)
    assert [answer.command is None for answer in answers] == [False] * MAX_SIMULATORS + [True] * 2
    assert len(list(tmp_path.glob("*.mcap"))) == MAX_SIMULATORS
    assert sum("are not driven" in line for line in printed) == 1


def test_who_connects_and_sends_nothing_takes_nobody_the_log(pilot_run: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    with DriveServer(load_pilot(pilot_run), DriveConfig(), log, port=0) as server:
        server.connected("in its menu")
        server.connected("a simulator")
        server.telemetry("a simulator", fields(0), time.perf_counter()).on_sent(1.0)
    assert list(tmp_path.iterdir()) == [log]
    assert len(images(log, "/camera/center")) == 1


def test_a_returning_simulator_goes_on_in_its_log_with_a_notice(pilot_run: Path, tmp_path: Path) -> None:
    log, printed = tmp_path / "run.mcap", list[str]()
    with DriveServer(load_pilot(pilot_run), DriveConfig(), log, port=0, notify=printed.append) as server:
        for name in ("a", "b"):
            server.connected(name)
            server.telemetry(name, fields(0), time.perf_counter()).on_sent(1.0)
            server.disconnected(name, "gone")
    assert [line for line in printed if line.startswith("connected again")] == [
        f"connected again: {log} continues"
    ]
    assert len(images(log, "/camera/center")) == 2


def test_a_simulator_that_comes_while_the_others_are_braked_is_braked_too(pilot_run: Path, tmp_path: Path) -> None:
    rolling = fields(0, speed="9.0000")
    with DriveServer(load_pilot(pilot_run), DriveConfig(), tmp_path / "run.mcap", port=0) as server:
        server.connected("a")
        server.telemetry("a", rolling, time.perf_counter()).on_sent(1.0)
        server.stop()  # as at a Ctrl-C
        server.connected("b")
        answer = server.telemetry("b", rolling, time.perf_counter())
        answer.on_sent(1.0)
    assert answer.command is not None
    assert answer.command.throttle == -1.0


def test_a_second_log_that_cannot_be_opened_leaves_the_first_drive_alone(pilot_run: Path, tmp_path: Path) -> None:
    log, printed = (
        tmp_path / f"{'x' * 238}.mcap",
        list[str](),
    )  # as long as a name may be, and the second's is longer
    with DriveServer(load_pilot(pilot_run), DriveConfig(), log, port=0, notify=printed.append) as server:
        commands = []
        for name in ("a", "b", "a", "b"):
            answer = server.telemetry(name, fields(0), time.perf_counter())
            answer.on_sent(1.0)
            commands.append(answer.command)
    assert [command is None for command in commands] == [False, True, False, True]
    assert sum("is not driven" in line for line in printed) == 1
    assert len(images(log, "/camera/center")) == 2


def test_who_goes_when_he_is_sent_something_unasked_ends_nobodys_drive(
    pilot_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drive.drive_session.WATCHDOG_S", 0.0)  # both are silent for too long
    with DriveServer(load_pilot(pilot_run), DriveConfig(), tmp_path / "run.mcap", port=0) as server:
        for name in ("a", "b"):
            server.connected(name)
            server.telemetry(name, fields(0), time.perf_counter()).on_sent(1.0)
        monkeypatch.setattr(server._server, "push", lambda sid, steer: server.disconnected(sid, "gone"))
        server.tick()
        assert not any(session.is_connected for session in server.sessions)


def test_a_malformed_telemetry_gets_the_last_steering_without_throttle(drive: Drive) -> None:
    for name, (_, driven) in zip(MALFORMED_NAMES, drive.between, strict=True):
        expected = {"steering_angle": driven["steering_angle"], "throttle": "0.000000"}
        assert drive.malformed[name] == ("steer", expected), name


def test_good_telemetries_between_malformed_ones_are_driven(drive: Drive) -> None:
    steering = [float(answer["steering_angle"]) for _, answer in drive.between]
    alone = [command.steering for command in drive.commands[: len(steering)]]
    assert steering == pytest.approx(alone, abs=1e-6)
    assert [event for event, _ in drive.between] == ["steer"] * len(MALFORMED_NAMES)


def test_each_malformed_telemetry_is_an_event_and_is_counted(drive: Drive) -> None:
    bad = [event for event in decoded(drive.log, "/events") if event.message.startswith("bad telemetry: ")]
    assert len(bad) == len(MALFORMED_NAMES)
    assert {event.level for event in bad} == {LogMessage.WARNING}
    assert f"{len(MALFORMED_NAMES)} telemetries could not be used: " in drive.stdout
    printed = [line for line in drive.stderr.splitlines() if "telemetry that cannot be used" in line]
    assert len(printed) == len(set(printed)) == len({reason_kind(event.message) for event in bad})
    reasons = dict(zip(MALFORMED_NAMES, (event.message for event in bad), strict=True))
    assert "image is larger" in reasons["too large an image"]
    assert "speed is not finite" not in reasons["a speed in words"]
    assert "image is not a JPEG or PNG (3 bytes)" in reasons["an image that is not a picture"]
    assert "speed is not a number (fast)" in reasons["a speed in words"]
    assert "image is missing (received: steering_angle, throttle, speed)" in reasons["no image"]


def reason_kind(message: str) -> str:
    """Without what differs from one telemetry to the next."""
    return message.partition(" (")[0]


def test_a_client_with_decimal_commas_is_understood_and_answered_in_kind(drive: Drive) -> None:
    assert drive.comma_client is not None
    assert (drive.comma_client.steers, drive.comma_client.bad_steers) == (COMMA, 0)
    alone = [command.steering for command in drive.commands[:COMMA]]
    assert [command.steering for command in drive.comma] == alone
    event, answer = drive.comma_wire
    assert event == "steer"
    assert all("," in value and "." not in value for value in answer.values())
    start = drive.frames - 1 - COMMA
    states = decoded(drive.log, "/vehicle")[start:-1]
    # the first telemetry's throttle "0,0000" has told the culture
    assert [state.speed_mph for state in states] == [1234.5] * COMMA


def test_ctrl_c_finishes_the_log_under_its_name(drive: Drive) -> None:
    assert drive.exit_code == 3  # some telemetries could not be used
    assert set(drive.log.parent.iterdir()) == {drive.log, drive.second_log}
    assert drive.stdout.startswith(f"{drive.log}: {drive.frames:,} frames")
    with Log(drive.log) as log:
        assert log.counts["/camera/center"] == drive.frames
        metadata = log.metadata
    assert metadata["weights_sha256"] == load_pilot(drive.run).weights_sha256
    assert (metadata["run"], metadata["source"], metadata["set_speed_mph"]) == ("untrained", "drive", "10")
    pilot = load_pilot(drive.run)
    assert (metadata["arithmetic"], metadata["device"]) == (pilot.arithmetic, pilot.device)


def test_a_port_in_use_is_one_line_and_writes_nothing(drive: Drive) -> None:
    assert "cannot listen on 127.0.0.1:" in drive.second
    assert "--port" in drive.second
    assert not (drive.log.parent / "second.mcap").exists()


def messages_so_far(part: Path, topic: str) -> list[bytes]:
    """The messages of a topic, in a log that is being written or was cut off: by mcap's own reader."""
    messages = []
    with part.open("rb") as stream, contextlib.suppress(McapError, EOFError):  # the end is cut
        reader = NonSeekingReader(stream, validate_crcs=True)
        for _, channel, message in reader.iter_messages(log_time_order=False):
            if channel.topic == topic:
                messages.append(message.data)
    return messages


def pictures_so_far(part: Path) -> list[bytes]:
    return [CompressedImage.FromString(data).data for data in messages_so_far(part, "/camera/center")]


def test_a_killed_drive_leaves_a_part_that_can_be_read(pilot_run: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    jpegs = [road_jpeg(i) for i in range(20)]
    with DriveProcess(pilot_run, log) as server:
        port = server.wait_until_it_listens()
        client = RawClient(port)
        for i in range(len(jpegs)):
            answer_to(client, fields(i))
        (part,) = tmp_path.glob("run.mcap.*.part")
        wait_until(lambda: len(messages_so_far(part, "/pilot/command")) == len(jpegs))  # the last of each row
        assert server.end(signal.SIGKILL) == -signal.SIGKILL
        client.close()
    assert not log.exists()
    assert pictures_so_far(part) == jpegs
    recovered = recover(part, recovered_name(part))
    assert recovered.path == log
    with Log(log) as whole:
        assert [whole.picture(row) for row in range(len(jpegs))] == jpegs


def test_an_existing_log_is_refused_before_anything_starts(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    log.write_bytes(b"precious")
    done = run("bc-drive", "no such run", "--log", log, "--port", 0)
    assert done.returncode == 1
    line = one_line_of(done)
    assert str(log) in line
    assert "--force" in line
    assert (log.read_bytes(), list(tmp_path.iterdir())) == (b"precious", [log])


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (("--laps", "2"), "--laps: only with --simulator TRACK;"),
        (("--real-time",), "--real-time: only with the built-in simulator"),
        (("--start", "5"), "--start: only with the built-in simulator"),
        (("--simulator", "lake", "--start", "-1"), "--start -1"),
        (("--simulator", "lake", "--host", "::1"), "--host: the built-in simulator"),
        (("--sessions", "x"), "--sessions: only with --takeover me"),
        (("--port", "65536"), "--port 65536: a port is"),
        (("--speed", "0"), "--speed 0: "),
        (("--smooth", "inf"), "--smooth inf: "),
        (("--steering-rate", "nan"), "--steering-rate nan: "),
        (("--log", "run.txt"), "--log run.txt: "),
        (("--simulator", "lake", "--laps", "nan"), "--laps nan: "),
        (("--aggregate", "3"), "--aggregate: was removed; drive with --takeover"),
    ],
)
def test_flags_that_would_be_passed_over_or_make_no_sense_are_bad_usage(
    flags: tuple[str, ...], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(drive_main, *flags) == 2
    assert expected in one_line_in(capsys)


def test_no_run_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(drive_main) == 1
    assert "bc-train" in one_line_in(capsys)
    assert list(tmp_path.iterdir()) == []


def test_at_the_end_the_car_is_braked_to_a_stand(pilot_run: Path, tmp_path: Path) -> None:
    """It would keep its last command, and one that brakes would reverse it in the end."""
    with DriveProcess(pilot_run, tmp_path / "run.mcap") as process:
        commands: list[SteerCommand] = []
        speed_mph = 9.0
        client = SimulatorClient(port=process.wait_until_it_listens(), wait_s=0)

        def next_telemetry(answer: ServerCommand) -> SimulatorMessage:
            nonlocal speed_mph
            if isinstance(answer, SteerCommand):
                commands.append(answer)
                speed_mph = max(0.0, speed_mph + min(answer.throttle, 0.0))
                if len(commands) == 10:
                    process.popen.send_signal(signal.SIGINT)
            return SimulatorTelemetry(0.0, 0.0, speed_mph, road_jpeg(len(commands)))

        with pytest.raises(WaitTimeoutError):  # it tells on and on, until nobody is there any more
            client.run(next_telemetry)
        assert process.join() == 0
    braking = [command.throttle for command in commands[10:]]
    assert braking.count(-1.0) >= 8
    assert commands[-1] == SteerCommand(0.0, 0.0)
    sent = decoded(tmp_path / "run.mcap", "/pilot/command")
    assert [command.steering for command in commands[:-1]] == pytest.approx(
        [command.steering for command in sent], abs=1e-6
    )


def test_a_drive_on_nothing_but_bad_telemetry_reports_so_and_fails(pilot_run: Path, tmp_path: Path) -> None:
    """A simulator of one's own cuts off its PNGs, and then forgets a field: each is said once, while it drives."""
    log = tmp_path / "run.mcap"
    png = base64.b64encode(b"\x89PNG\r\n\x1a\n" + bytes(99)).decode()
    with DriveProcess(pilot_run, log) as process:
        client = RawClient(process.wait_until_it_listens())
        for _ in range(20):
            answer_to(client, fields(0, image=png))
        process.wait_for("telemetry that cannot be used: image is a PNG that is cut off or damaged")
        answer_to(client, fields(0, image="data:image/jpeg;base64,AAAA"))
        answer_to(client, fields(0, speed=...))
        client.close()
        assert process.end() == 1
    printed = [line for line in process.stderr if "cannot be used" in line]
    assert len(printed) == 3
    assert "speed is missing (received: steering_angle, throttle, image)" in printed[2]
    assert (
        "nothing was driven: no telemetry could be used (image is a PNG that is cut off or damaged)"
        in process.stderr[-1]
    )
    assert "bc-play" not in process.stdout
    assert "autonomy unknown" in process.stdout
    expected = (
        "22 telemetries could not be used: image is a PNG that is cut off or damaged (20), image begins with data:"
    )
    assert expected in process.stdout
    checked = run("bc-log", "check", log)
    assert checked.returncode == 3
    assert "image is a PNG that is cut off or damaged (20)" in checked.stdout


def test_a_car_that_cannot_be_braked_is_named_and_a_second_ctrl_c_ends(
    pilot_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It tells 9 mph, and then nothing any more."""
    with DriveProcess(pilot_run, tmp_path / "run.mcap", minds_silence=True) as process:
        client = RawClient(process.wait_until_it_listens())
        answer_to(client, fields(0, speed="30.0000"))
        process.popen.send_signal(signal.SIGINT)
        process.wait_for("the car is braked to a stand; Ctrl-C again ends at once")
        process.popen.send_signal(signal.SIGINT)
        assert process.join() == 0
        client.close()
    assert "bc-drive: the car may still roll: its simulator is silent" in process.stderr
    assert (tmp_path / "run.mcap").exists()


@pytest.mark.parametrize("answers_braked", [pytest.param(0, marks=pytest.mark.long), 2])
def test_a_silent_simulator_is_sent_the_brake_and_its_release(
    pilot_run: Path, tmp_path: Path, answers_braked: int
) -> None:
    """One that is silent for long when Ctrl-C is pressed, and one that falls silent while it is braked: both keep
    their last command for ever."""
    log = tmp_path / "run.mcap"
    with DriveProcess(pilot_run, log, minds_silence=True) as process:
        client = ModernClient(process.wait_until_it_listens())
        client.tell(fields(0))
        if answers_braked:
            process.popen.send_signal(signal.SIGINT)
            while client.answers[-1][1]["throttle"] != "-1.000000" or answers_braked > 1:
                answers_braked -= client.tell(fields(0))[1]["throttle"] == "-1.000000"
        else:
            client.wait_for(2)  # it was pushed on, and stays silent
            process.popen.send_signal(signal.SIGINT)
        assert process.join() == 0
        client.close()
    throttles = [float(command["throttle"]) for _, command in client.answers]
    braked = throttles[throttles.index(-1.0) :]
    assert set(braked[: braked.index(0.0)]) == {-1.0}
    assert set(braked[braked.index(0.0) :]) == {0.0}
    printed = [line for line in process.stderr if "brake" in line or "roll" in line]
    assert printed == [
        "bc-drive: the car is braked to a stand; Ctrl-C again ends at once",
        "bc-drive: the car may still roll: its simulator is silent",
    ]
    assert events(log).count("the drive ends: the car is braked to a stand") == 1


def test_a_brake_is_released_after_the_stopping_time_and_logged_once(
    pilot_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a clock of the test's own: at 9 mph the car needs about 0.6 s."""
    now_s = 100.0
    with DriveServer(load_pilot(pilot_run), DriveConfig(), tmp_path / "run.mcap", port=0) as server:
        session = server.session
        monkeypatch.setattr(time, "monotonic", lambda: now_s)
        server.connected("a")
        server.telemetry("a", fields(0), time.perf_counter()).on_sent(1.0)
        for _ in range(5):  # it ticks: a process that stood still would not know of any silence
            now_s += 0.1
            assert session.watchdog_steer() is None
        session.stop()
        assert session.stop_notice == ""
        sent = {}
        for tick in range(20):
            if (steer := session.brake_steer()) is not None:
                sent[tick] = steer.throttle
            now_s += 0.1
        assert session.stop_notice == "the car is braked to a stand"
        (braked, released) = sent
        assert (braked, list(sent.values())) == (0, [-1.0, 0.0])
        assert 4 <= released <= 9
        assert session.is_at_rest
        assert session.end_notice() == "the car may still roll: its simulator is silent"
        session.connected()  # silence on the drive: a brake is not repeated
        server.telemetry("a", fields(0, speed="30.0000"), time.perf_counter()).on_sent(1.0)
        for _ in range(30):
            now_s += 0.1
            answer = server.telemetry("a", fields(0, speed="30.0000", image="@"), time.perf_counter())
        assert answer.command is not None
        pushed = None
        while pushed is None:
            now_s += 0.1
            pushed = session.watchdog_steer()
        assert pushed.throttle == 0.0


def test_braking_is_an_event_and_not_the_pilots(pilot_run: Path, tmp_path: Path) -> None:
    log, printed = tmp_path / "run.mcap", list[str]()
    with DriveServer(load_pilot(pilot_run), DriveConfig(), log, port=0, notify=printed.append) as server:
        server.connected("a")

        def tell(speed: str, **changed: Any) -> float:
            answer = server.telemetry("a", fields(0, speed=speed, **changed), time.perf_counter())
            answer.on_sent(1.0)
            assert answer.command is not None
            return answer.command.throttle

        tell("9.0000")
        server.stop()
        assert [tell("9.0000"), tell("8.0000", image="%%%"), tell("0.4000"), tell("0.0000")] == [-1, -1, 0, 0]
        assert server.session.is_at_rest
    commands = decoded(log, "/pilot/command")
    assert [command.driver for command in commands] == [PilotCommand.PILOT] + [PilotCommand.BRAKE] * 3
    assert events(log).count("the drive ends: the car is braked to a stand") == 1


@pytest.mark.needs("ipv6")
def test_a_simulator_is_driven_over_ipv6(pilot_run: Path, tmp_path: Path) -> None:
    answers: list[ServerCommand] = []

    def drive_once(answer: ServerCommand) -> SimulatorTelemetry | None:
        answers.append(answer)
        return SimulatorTelemetry(0.0, 0.0, 0.0, road_jpeg(0)) if answer is None else None

    with DriveProcess(pilot_run, tmp_path / "run.mcap", "--host", "::1") as process:
        port = int(process.wait_for(r"is waiting for a simulator on \[::1\]:(\d+)$")[1])
        SimulatorClient("::1", port, wait_s=PATIENCE_S, in_flight=1).run(drive_once)
        assert process.end() == 0
    assert isinstance(answers[1], SteerCommand)


def test_the_live_line_reports_when_the_simulator_has_gone(pilot_run: Path, tmp_path: Path) -> None:
    shown: list[str] = []
    with DriveServer(
        load_pilot(pilot_run), DriveConfig(), tmp_path / "run.mcap", port=0, show_status=shown.append
    ) as server:
        server.connected("a")
        server.telemetry("a", fields(0), time.perf_counter()).on_sent(1.0)
        server.tick()
        server.disconnected("a", "gone")
        server.tick()
    assert "9.0 mph" in shown[0]
    assert shown[1:] == ["the simulator has disconnected: waiting, with 1 frame so far"]


def test_a_simulator_that_falls_silent_is_steered_once_unasked(pilot_run: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    with DriveProcess(pilot_run, log, minds_silence=True) as process:
        client = ModernClient(process.wait_until_it_listens())
        answer = client.tell(fields(1))
        client.wait_for(2)
        assert client.answers == [answer, answer]
        client.tell(fields(2))
        client.wait_for(4)  # once for each silence
        client.close()
        assert process.end() == 0
    pushed = [event for event in decoded(log, "/events") if event.message.startswith("no telemetry for a second")]
    assert [event.level for event in pushed] == [LogMessage.WARNING] * 2


def test_a_client_that_sends_nothing_is_told_what_to_do(pilot_run: Path, tmp_path: Path) -> None:
    with DriveProcess(pilot_run, tmp_path / "run.mcap") as process:
        client = ModernClient(process.wait_until_it_listens())
        process.wait_for("connected, but no telemetry comes: choose Autonomous Mode")
        client.close()
        assert process.end() == 1
    assert "sent no telemetry" in process.stderr[-1]
    assert list(tmp_path.iterdir()) == []


def test_a_drive_without_a_simulator_leaves_no_log(pilot_run: Path, tmp_path: Path) -> None:
    with DriveProcess(pilot_run, tmp_path / "run.mcap") as process:
        process.wait_until_it_listens()
        assert process.end() == 1
    assert "no simulator connected" in process.stderr[-1]
    assert list(tmp_path.iterdir()) == []


def test_a_drive_is_shown_in_a_file_while_it_goes_on(pilot_run: Path, tmp_path: Path) -> None:
    rrd = tmp_path / "run.rrd"
    rrd.write_bytes(b"of an earlier drive")
    with DriveProcess(pilot_run, tmp_path / "run.mcap", "--viewer", rrd, "--force") as process:
        replay(SimulatorClient(port=process.wait_until_it_listens()), [road_jpeg(i) for i in range(20)])
        assert process.end() == 0
    shown = contents(rrd)
    assert len(shown["/camera/center"]["message_log_time"]) == 20
    assert len(shown["/steering/predicted"]["message_log_time"]) == 20


def test_what_the_disk_could_not_take_is_counted_and_said(
    pilot_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("drive.log.drive_log.MAX_PICTURE_BYTES", 0)
    (port,) = free_ports(1)
    jpegs = [road_jpeg(i) for i in range(5)]

    def drive_and_stop() -> None:
        replay(SimulatorClient(port=port, wait_s=PATIENCE_S), jpegs)
        signal.raise_signal(signal.SIGINT)

    simulator = threading.Thread(target=drive_and_stop)
    simulator.start()
    threads = torch.get_num_threads()
    try:
        code = drive_command(DriveCommand(str(pilot_run), log=tmp_path / "run.mcap", port=port))
    finally:
        torch.set_num_threads(threads)
        simulator.join(PATIENCE_S)
    assert code == 3
    assert "10 pictures" in capsys.readouterr().err
    assert len(decoded(tmp_path / "run.mcap", "/pilot/command")) == len(jpegs)  # commands come before pictures
    assert not decoded(tmp_path / "run.mcap", "/camera/center")


def test_a_full_disk_brakes_the_car_and_names_the_file(pilot_run: Path, tmp_path: Path) -> None:
    throttles: list[float] = []

    def braked_at_once(answer: ServerCommand) -> SimulatorTelemetry:
        if isinstance(answer, SteerCommand):
            throttles.append(answer.throttle)
        return SimulatorTelemetry(0.0, 0.0, 0.0 if -1.0 in throttles else 9.0, road_jpeg(0))

    # the system refuses a file that grows above this as it refuses one on a full disk
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))"
    line = command_after([limit], "bc-drive", pilot_run, "--log", tmp_path / "run.mcap", "--port", 0)
    with Process(line) as process:
        port = int(process.wait_for(r"is waiting for a simulator on 127\.0\.0\.1:(\d+)")[1])
        with pytest.raises(WaitTimeoutError):
            SimulatorClient(port=port, wait_s=0).run(braked_at_once)
        assert process.join() == 1
    assert -1.0 in throttles
    assert throttles[-1] == 0.0  # braked, and not reversed
    (part,) = tmp_path.iterdir()
    assert str(part) in process.stderr[-1]
    assert "File too large" in process.stderr[-1]
    assert "Traceback" not in "".join(process.stderr)


def send_too_much(port: int) -> None:
    """A telemetry, and then one of 5 MB; until the server hangs up."""
    client = RawClient(port)
    client.tell(fields(0))
    with contextlib.suppress(ConnectionError, websocket.WebSocketConnectionClosedException):
        client.tell("A" * (5 << 20))
    client.until_hung_up()


def send_broken_packet(port: int) -> list[str]:
    """A telemetry, and then what is no packet; what came until the server has hung up."""
    client = RawClient(port)
    client.tell(fields(0))
    client.websocket.send("42[]")
    received = [str(message) for message in iter(client.websocket.recv, "")]
    client.vanish()
    return received


def test_each_stranger_is_a_line_and_simulators_are_driven_on(pilot_run: Path, tmp_path: Path) -> None:
    """A page in the user's browser can reach this machine's ports; its requests carry where it comes from."""
    log = tmp_path / "run.mcap"

    def has_gone(times: int) -> bool:
        return sum("message too large" in line for line in process.stderr) == times

    with DriveProcess(pilot_run, log) as process:
        port = process.wait_until_it_listens()
        url = f"ws://127.0.0.1:{port}/socket.io/?EIO=4&transport=websocket"
        with pytest.raises(websocket.WebSocketBadStatusException):
            websocket.create_connection(url, timeout=PATIENCE_S, origin="http://elsewhere.example")
        websocket.create_connection(url, timeout=PATIENCE_S, suppress_origin=True).close()
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=PATIENCE_S) as page:
            assert "simulator" in page.read().decode()
        for times in (1, 2):
            send_too_much(port)
            wait_until(partial(has_gone, times))
        assert sum(message.startswith('42["steer"') for message in send_broken_packet(port)) == 1
        assert len(replay(SimulatorClient(port=port), [road_jpeg(i) for i in range(3)])) == 3
        assert process.end() == 0
    lines = [line for line in process.stderr if "broken packet" in line]
    assert lines == [f"bc-drive: disconnected (broken packet): {log} has 3 frames so far; waiting"]
    assert sum("a browser has opened this port" in line for line in process.stderr) == 1
    assert sum("disconnected (message too large)" in line for line in process.stderr) == 2
    assert "Traceback" not in "".join(process.stderr)
