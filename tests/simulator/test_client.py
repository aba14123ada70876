"""The client does on the wire what the real simulator was seen to do: checked by a bare websocket server."""

from __future__ import annotations

import base64
import gc
import json
import socket
from collections.abc import Callable

import pytest

from simulator.cli import main as sim_main
from simulator.protocol.client import (
    FRAME_BYTES,
    ServerCommand,
    SimulatorClient,
    SimulatorMessage,
    SimulatorTelemetry,
    SteerCommand,
    WaitTimeoutError,
)
from simulator.protocol.replay import replay
from tests.helpers.bare_server import OPEN, BareServer, Wire, steer
from tests.helpers.driving import road_jpeg
from tests.helpers.udacity import call


def begin(wire: Wire) -> None:
    """Two telemetries come unasked."""
    wire.say(OPEN)
    wire.hear_telemetry()
    wire.hear_telemetry()


def serve_for_ever(wire: Wire) -> None:
    """One telemetry comes for each steer."""
    begin(wire)
    while True:
        wire.say(steer())
        wire.hear_telemetry()


def telling(
    reported: list[SimulatorMessage], answers: list[ServerCommand]
) -> Callable[[ServerCommand], SimulatorMessage]:
    rest = iter(reported)

    def next_telemetry(answer: ServerCommand) -> SimulatorMessage:
        answers.append(answer)
        return next(rest, None)

    return next_telemetry


def test_it_announces_no_connection_and_sends_two_telemetries_first() -> None:
    def serve(wire: Wire) -> None:
        begin(wire)
        wire.say(steer())
        wire.hear_telemetry()
        wire.say(steer("-0.5000", "-1.0000"))
        wire.hear()
        wire.hear()

    answers: list[ServerCommand] = []
    reported: list[SimulatorMessage] = [SimulatorTelemetry(0.0, 0.0, 9.0, road_jpeg(i)) for i in range(3)]
    with BareServer(serve) as server:
        SimulatorClient(port=server.port).run(telling(reported, answers))
    (wire,) = server.wires
    assert wire.request.startswith("GET /socket.io/?EIO=4&transport=websocket HTTP/1.1\r\n")
    assert not any(message.startswith("40") for message in wire.messages)
    assert [message[:14] for message in wire.messages if message != "2"] == ['42["telemetry"'] * 3 + ["41", "1"]
    assert wire.messages.count("2") == 1  # its heartbeat begins at once
    assert answers == [None, None, SteerCommand(0.1, 0.2), SteerCommand(-0.5, -1.0)]


def test_a_telemetry_has_four_decimals_in_frames_of_1016_bytes() -> None:
    jpeg = road_jpeg(0)
    with BareServer(serve_for_ever) as server:
        SimulatorClient(port=server.port).run(telling([SimulatorTelemetry(-0.5, 0.25, 1234.56789, jpeg)] * 3, []))
    (wire,) = server.wires
    name, fields = json.loads(wire.messages[0][2:])
    assert name == "telemetry"
    assert base64.b64decode(fields.pop("image")) == jpeg
    assert fields == {"steering_angle": "-12.5000", "throttle": "0.2500", "speed": "1,234.5679"}
    end = next(i for i, frame in enumerate(wire.frames) if frame.is_last)
    message = wire.frames[: end + 1]
    assert len(message) > 3
    assert [frame.opcode for frame in message] == [1] + [0] * end
    assert [len(frame.payload) for frame in message[:-1]] == [1016] * end == [FRAME_BYTES] * end
    assert 0 < len(message[-1].payload) <= 1016


def test_a_world_is_reported_beside_the_strings_as_an_object_of_numbers() -> None:
    jpeg = road_jpeg(0)
    world = {"time_s": 1.5, "offset": -0.1, "interventions": 2}
    reported: list[SimulatorMessage] = [
        SimulatorTelemetry(-0.5, 0.25, 9.0, jpeg),
        SimulatorTelemetry(-0.5, 0.25, 9.0, jpeg, world),
    ]
    with BareServer(serve_for_ever) as server:
        SimulatorClient(port=server.port, decimal_comma=True).run(telling(reported, []))
    plain, with_world = (m for m in server.wires[0].messages if m.startswith("42"))
    # the same bytes to the last brace: an object is added, and nothing else is changed
    assert plain.endswith('"}]')
    assert with_world == plain[:-2] + ',"world":{"time_s":1.5,"offset":-0.1,"interventions":2}}]'


def test_a_machine_with_decimal_commas_writes_and_reads_them() -> None:
    def serve(wire: Wire) -> None:
        wire.say(OPEN)
        wire.hear_telemetry()
        wire.say(steer("0,2500", "-1,0000"))
        while True:
            wire.hear()

    answers: list[ServerCommand] = []
    with BareServer(serve) as server:
        client = SimulatorClient(port=server.port, decimal_comma=True)
        client.run(telling([SimulatorTelemetry(-0.5, 0.25, 1234.5, b"\xff\xd8")] * 2, answers))
    _, fields = json.loads(server.wires[0].messages[0][2:])
    assert (fields["steering_angle"], fields["throttle"], fields["speed"]) == ("-12,5000", "0,2500", "1.234,5000")
    assert answers[2] == SteerCommand(0.25, -1.0)


def test_nagles_algorithm_is_on_as_in_the_real_one() -> None:
    options: list[int] = []

    def next_telemetry(answer: ServerCommand) -> SimulatorMessage:
        for open_socket in (thing for thing in gc.get_objects() if issubclass(type(thing), socket.socket)):
            if open_socket.fileno() >= 0 and open_socket.family == socket.AF_INET:
                try:
                    port = open_socket.getpeername()[1]
                except OSError:  # not connected
                    continue
                if port == server.port:
                    options.append(open_socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
        return None

    with BareServer(serve_for_ever) as server:
        SimulatorClient(port=server.port).run(next_telemetry)
    assert options == [0]


def test_a_servers_ping_is_answered() -> None:
    heard: list[str] = []

    def serve(wire: Wire) -> None:
        begin(wire)
        wire.say("2")
        heard.append(next(message for message in iter(wire.hear, "") if message != "2"))
        wire.say(steer())
        wire.hear()

    with BareServer(serve) as server:
        SimulatorClient(port=server.port).run(telling([SimulatorTelemetry(0, 0, 0, b"\xff")] * 2, []))
    assert heard == ["3"]


def test_a_command_that_it_cannot_read_costs_a_telemetry_and_is_counted() -> None:
    nonsense = [
        steer(0.1, 0.2),
        steer("", "0.2"),
        steer("nan", "0.2"),
        steer("0.1", "inf"),
        steer("left", "0.2"),
        steer(None, "0.2"),
        '42["steer",{"throttle":"0.2"}]',
        '42["steer",{}]',
        '42["steer",null]',
        '42["steer"]',
    ]

    def serve(wire: Wire) -> None:
        begin(wire)
        for message in nonsense:  # nothing comes of it
            wire.say(message)
        wire.say(steer("0.5", "0.5"))
        while True:
            wire.hear()

    answers: list[ServerCommand] = []
    with BareServer(serve) as server:
        client = SimulatorClient(port=server.port)
        client.run(telling([SimulatorTelemetry(0, 0, 0, b"\xff")] * 2, answers))
    assert answers == [None, None, SteerCommand(0.5, 0.5)]
    assert (client.steers, client.bad_steers, client.telemetries) == (1, len(nonsense), 2)


def test_what_is_no_command_is_ignored() -> None:
    deep = f"42{'[' * 9_999}"

    def serve(wire: Wire) -> None:
        begin(wire)
        for message in ("40", '40{"sid":"x"}', "43[]", "6", '42["other",{}]', "42[]", "42{", "42", deep):
            wire.say(message)
        wire.say("42" + json.dumps(["manual", {}]))
        while True:
            wire.hear()

    answers: list[ServerCommand] = []
    with BareServer(serve) as server:
        client = SimulatorClient(port=server.port)
        client.run(telling([SimulatorTelemetry(0, 0, 0, b"\xff"), "manual"], answers))
    assert answers == [None, None, "manual"]
    assert [m for m in server.wires[0].messages if m.startswith("42")][1] == '42["telemetry",null]'
    assert (client.steers, client.manuals, client.bad_steers) == (0, 1, 0)


def test_it_connects_again_when_the_server_dies_in_the_middle() -> None:
    def die_after_three(wire: Wire) -> None:
        begin(wire)
        wire.say(steer())
        wire.hear_telemetry()

    answers: list[ServerCommand] = []
    reported: list[SimulatorMessage] = [SimulatorTelemetry(0, 0, 0, b"\xff")] * 8
    with BareServer(die_after_three, serve_for_ever) as server:
        client = SimulatorClient(port=server.port)
        client.run(telling(reported, answers))
    assert client.connections == 2
    assert client.telemetries == 8
    assert answers[:5] == [None, None, SteerCommand(0.1, 0.2), None, None]


def test_a_replay_shows_every_picture_once_and_waits_for_the_last_answer() -> None:
    def answer_each(wire: Wire) -> None:
        wire.say(OPEN)
        while True:
            wire.hear_telemetry()
            wire.say(steer())

    pictures = [road_jpeg(i) for i in range(5)]
    with BareServer(answer_each) as server:
        commands = replay(SimulatorClient(port=server.port), pictures)
    assert commands == [SteerCommand(0.1, 0.2)] * 5
    reported = [json.loads(message[2:])[1] for message in server.wires[0].messages if message.startswith("42")]
    assert [base64.b64decode(fields["image"]) for fields in reported] == pictures
    assert {fields["steering_angle"] for fields in reported[2:]} <= {"0.0000", "2.5000"}
    assert reported[-1]["steering_angle"] == "2.5000"


def test_it_gives_up_when_there_is_no_server() -> None:
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))  # taken, and not listening
        client = SimulatorClient(port=nobody.getsockname()[1], wait_s=0.2)
        with pytest.raises(WaitTimeoutError, match=r"within 0\.2 s"):
            client.run(lambda answer: None)
    assert client.connections == 0


@pytest.mark.parametrize(("flag", "is_told"), [("", True), ("--real-time", False), ("--tell-world", False)])
def test_the_built_in_simulator_reports_where_its_time_is_not_the_clocks(
    flag: str, is_told: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        flags = [flag] if flag else []
        assert call(sim_main, "--port", nobody.getsockname()[1], "--wait", 0, *flags) == 1
    assert ("distances and times in the log" in capsys.readouterr().err) == is_told
