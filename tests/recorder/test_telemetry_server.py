"""The server that simulators connect to: every telemetry is answered, whoever tells it and whatever it is, in both
modes of the server; whoever else knocks costs one line."""

from __future__ import annotations

import contextlib
import gc
import itertools
import json
import random
import re
import socket
import threading
import urllib.error
import urllib.request
from collections.abc import Callable
from typing import Any, Literal

import pytest
import websocket
from websocket import ABNF

from recorder.errors import ListenError
from recorder.server import eventlet_host, telemetry_server
from recorder.server.connection_guard import listen
from recorder.server.eventlet_host import QuickAckGreenSocket
from recorder.server.telemetry import TelemetryError, parse_telemetry
from recorder.server.telemetry_server import MAX_MESSAGE_BYTES, Answer, Steer, TelemetryServer
from recorder.server.websocket import WebSocket
from simulator.protocol.client import ServerCommand, SimulatorClient, SimulatorMessage, SimulatorTelemetry
from tests.helpers.driving import PATIENCE_S
from tests.helpers.ports import free_ports
from tests.helpers.serving import (
    PICTURES,
    UNUSED,
    Book,
    ModernClient,
    PollingClient,
    RawClient,
    Serving,
    fields,
    malformed,
    steered,
    steering,
    tell,
)
from tests.helpers.waiting import wait_until


def test_old_and_modern_clients_are_served_at_once_on_one_port() -> None:
    book = Book()
    old: list[ServerCommand] = []
    with Serving(book) as serving:
        others = [
            threading.Thread(target=lambda: old.extend(tell(serving.port, range(40)))),
            threading.Thread(target=tell, args=(serving.port, range(40)), kwargs={"decimal_comma": True}),
        ]
        for other in others:
            other.start()
        modern = ModernClient(serving.port)
        answers = [modern.tell(fields(number)) for number in range(100, 140)]
        modern.close()
        polling = PollingClient(serving.port)
        answers += [polling.tell(fields(number)) for number in range(140, 145)]
        upgraded = polling.upgraded()
        for number in range(145, 150):
            upgraded.tell(fields(number))
            answers.append(upgraded.command())
        upgraded.close()
        for other in others:
            other.join(PATIENCE_S)
        wait_until(lambda: book.calls.count("disconnected") == 4)
    assert [answer.steering for answer in old if not isinstance(answer, str | None)] == [
        pytest.approx(-steering(number), abs=1e-6) for number in range(40)
    ]
    assert answers == [steered(Steer(-steering(number), 0.5)) for number in range(100, 150)]
    assert book.calls.count("telemetry") == book.calls.count("answered") == 40 + 40 + 50
    assert book.calls.count("connected") == 4
    assert book.overlaps == 0
    assert serving.notices == []


def test_a_telemetry_is_timed_from_its_last_byte_to_the_answers_leaving() -> None:
    book = Book()
    has_answer = threading.Event()

    class Waiting(Book):
        def answered(self, total_ms: float) -> None:
            assert has_answer.wait(PATIENCE_S)  # it has left, or nobody could have got it
            has_answer.clear()
            super().answered(total_ms)

    book = Waiting()
    with Serving(book) as serving:
        client = RawClient(serving.port)
        for number in range(5):
            client.tell(fields(number))
            assert client.command() == steered(Steer(-steering(number), 0.5))
            has_answer.set()
            wait_until(lambda count=number + 1: len(book.answered_ms) == count)  # type: ignore[misc]
        client.close()
    for waited_ms, total_ms in zip(book.waited_ms, book.answered_ms, strict=True):
        assert 0 < waited_ms < total_ms


@pytest.mark.skipif(not hasattr(socket, "TCP_QUICKACK"), reason="only Linux delays and can be told not to")
def test_what_comes_is_acknowledged_at_once_and_answers_do_not_wait() -> None:
    """In the middle of question and answer, where Linux by itself delays."""
    listener = listen("127.0.0.1", 0, QuickAckGreenSocket)
    client = socket.create_connection(listener.getsockname(), PATIENCE_S)
    server, _ = listener.accept()
    with contextlib.closing(listener), client, contextlib.closing(server):
        assert server.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) != 0
        for _ in range(10):
            client.sendall(b"telemetry")
            assert server.recv(100) == b"telemetry"
            assert server.getsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK) == 1
            server.sendall(b"steer")
            assert client.recv(100) == b"steer"


def test_a_simulator_drives_on_with_a_server_that_comes_back() -> None:
    answers: list[ServerCommand] = []
    first, second = Book(), Book()

    def next_telemetry(answer: ServerCommand) -> SimulatorMessage:
        answers.append(answer)
        return None if len(second.answered_ms) >= 5 else SimulatorTelemetry(0.5, 0.0, 9.0, PICTURES[0])

    (port,) = free_ports(1)
    with Serving(first, port):
        client = SimulatorClient(port=port, wait_s=PATIENCE_S)
        simulator = threading.Thread(target=client.run, args=(next_telemetry,))
        simulator.start()
        wait_until(lambda: len(first.answered_ms) >= 5)
    with Serving(second, port):
        simulator.join(PATIENCE_S)
    assert client.connections == 2
    assert client.bad_steers == 0
    assert second.calls[0] == "connected"


def test_a_client_that_never_pauses_keeps_nobody_else_out() -> None:
    book = Book()
    enough = threading.Event()
    with Serving(book) as serving:
        restless = RawClient(serving.port)

        def tell_on() -> None:
            while not enough.is_set():
                restless.tell(1)

        def hear_on() -> None:
            with contextlib.suppress(websocket.WebSocketException, OSError):
                while restless.websocket.recv():
                    pass

        threads = [threading.Thread(target=tell_on), threading.Thread(target=hear_on)]
        for thread in threads:
            thread.start()
        wait_until(lambda: len(book.answered_ms) > 0)
        assert len(tell(serving.port, range(5))) == 5
        ticks = book.ticks
        wait_until(lambda: book.ticks > ticks)
        enough.set()
        threads[0].join(PATIENCE_S)
        serving.stop()
        threads[1].join(PATIENCE_S)
        restless.vanish()


def test_the_tick_can_push_a_command_that_nobody_asked_for() -> None:
    class Pushing(Book):
        server: TelemetryServer
        sid = ""

        def connected(self, sid: str) -> None:
            self.sid = sid

        def tick(self) -> None:
            if self.sid:
                self.server.push(self.sid, Steer(0.25, 0.5, ","))
                self.server.push("nobody", Steer(0.25, 0.5, ","))
                self.sid = ""

    book = Pushing()
    with Serving(book) as serving:
        book.server = serving.server
        client = RawClient(serving.port, "40")
        assert client.command() == ("steer", {"steering_angle": "0,250000", "throttle": "0,500000"})
        client.close()


def test_who_was_steered_gets_a_last_command_at_the_end() -> None:
    book = Book()
    book.last = Steer(0.0, -0.125)
    with Serving(book) as serving:
        driven, manual = RawClient(serving.port), RawClient(serving.port)
        driven.tell(1)
        manual.tell(None)
        assert driven.command() == steered(UNUSED)
        assert manual.command() == ("manual", {})
        serving.stop()
        assert driven.command() == steered(book.last)
        for client in (driven, manual):
            client.until_hung_up()
    assert book.calls.count("final_command") == 1
    assert "disconnected" not in book.calls


def test_no_answer_comes_after_the_last_command(monkeypatch: pytest.MonkeyPatch) -> None:
    """Others may run between an answer and its sending, and the car keeps what it is sent last."""
    is_answering, goes_on = threading.Event(), threading.Event()
    send = WebSocket.send

    def send_late(websocket: WebSocket, message: str | bytes) -> None:
        if "steer" in str(message) and not is_answering.is_set():
            is_answering.set()
            while not goes_on.is_set():
                eventlet_host.let_others_run()
        send(websocket, message)

    monkeypatch.setattr(WebSocket, "send", send_late)
    monkeypatch.setattr(telemetry_server, "END_S", PATIENCE_S)
    book = Book()
    book.last = Steer(0.0, -0.125)
    with Serving(book) as serving:
        client = RawClient(serving.port)
        client.tell(1)
        assert is_answering.wait(PATIENCE_S)
        ender = threading.Thread(target=serving.stop)
        ender.start()
        ender.join(0.3)  # it cannot end yet; without the waiting, its last command has left by now
        goes_on.set()
        assert [client.command(), client.command()] == [steered(UNUSED), steered(book.last)]
        client.until_hung_up()
        ender.join(PATIENCE_S)
    assert book.calls[-2:] == ["answered", "final_command"]


def test_nothing_of_it_is_left_when_it_has_ended_whoever_was_connected() -> None:
    before = set(threading.enumerate())
    with Serving(Book(), *free_ports(1)) as serving:
        simulator = RawClient(serving.port, '42["telemetry",1]')
        polling = PollingClient(serving.port)
        polled: list[str] = []
        poll = threading.Thread(target=lambda: polled.append(polling.request()))
        poll.start()
        silent = socket.create_connection(("127.0.0.1", serving.port))
        half = socket.create_connection(("127.0.0.1", serving.port))
        half.sendall(b"GET / HTT")
        assert simulator.command() == steered(UNUSED)
        serving.stop()
        poll.join(PATIENCE_S)
        assert polled == ["1"]
        for stream in (silent, half):
            stream.settimeout(PATIENCE_S)
            with contextlib.suppress(ConnectionError):
                assert stream.recv(1) == b""
            stream.close()
        simulator.until_hung_up()
        assert set(threading.enumerate()) - {serving.thread} <= before
    with socket.create_server(("127.0.0.1", serving.port)):
        pass


def test_clients_that_come_and_go_leave_nothing_behind() -> None:
    book = Book()

    def connections() -> int:
        gc.collect()
        return sum(type(thing) is WebSocket for thing in gc.get_objects())

    with Serving(book) as serving:
        threads, before = threading.active_count(), connections()
        for number in range(20):
            client = RawClient(serving.port, "40", '42["telemetry",1]', "2")
            client.command()
            if number % 2:
                client.vanish()  # without a word
            else:
                client.close()
        wait_until(lambda: book.calls.count("disconnected") == 20)
        wait_until(lambda: threading.active_count() <= threads)  # fewer, if one of earlier clients has ended
        wait_until(lambda: connections() <= before)


@pytest.mark.parametrize("where", ["connected", "telemetry", "answered", "tick", "disconnected", "final_command"])
def test_what_the_handler_raises_ends_the_run_and_is_raised_there(
    where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(eventlet_host, "END_S", 0.01)  # the client that is still there need not end by itself

    class DiskError(Exception):
        pass

    def fail(*arguments: object) -> None:
        raise DiskError(where)

    book = Book()
    setattr(book, where, fail)
    serving = Serving(book)
    with contextlib.suppress(DiskError), serving:
        client = RawClient(serving.port, '42["telemetry",1]')
        if where not in ("connected", "telemetry", "tick"):
            client.command()
        if where == "disconnected":
            client.close()
        if where != "final_command":
            serving.join()
        serving.stop()
        client.until_hung_up()
    assert isinstance(serving.error, DiskError)


def test_a_port_in_use_reports_what_to_do() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ListenError, match=rf"127\.0\.0\.1:{port} .*bc-drive.*--port"):
            TelemetryServer(Book(), port=port)


@pytest.mark.parametrize("host", ["no such host", "a" * 100, "\0", "192.0.2.1"])
def test_a_host_that_is_not_here_is_one_line(host: str) -> None:
    with pytest.raises(ListenError, match=r"cannot listen on .*; give an address of this machine by --host"):
        TelemetryServer(Book(), host=host, port=0)


@pytest.mark.needs("ipv6")
@pytest.mark.parametrize("host", ["::1", "[::1]", "six.test"])
def test_a_simulator_comes_over_ipv6(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """To an address, as in a URL or not, or to a name that has no other."""
    resolve = socket.getaddrinfo

    def with_a_name(name: str, *more: Any, **options: Any) -> Any:
        return resolve("::1" if name == "six.test" else name, *more, **options)

    monkeypatch.setattr(socket, "getaddrinfo", with_a_name)
    book = Book()
    with Serving(book, host=host) as serving:
        tell(serving.port, range(3), host=host)
    assert len(book.answered_ms) == 3
    assert serving.notices == []


def test_broken_packets_are_hung_up_on_and_said_once() -> None:
    book = Book()
    broken: list[str | bytes] = [
        "42[]",
        "42{}",
        "42[1]",
        "x",
        '42["connect",{}]',
        "42" + "[" * 100_000,
        b"\xff" * 100,
    ]
    with Serving(book) as serving:
        for hello, packet in itertools.product(([], ["40"]), broken):
            client = RawClient(serving.port, *hello)
            client.websocket.send(packet, ABNF.OPCODE_BINARY if isinstance(packet, bytes) else ABNF.OPCODE_TEXT)
            client.until_hung_up()
        assert tell(serving.port, range(3))
        wait_until(lambda: book.calls.count("connected") == book.calls.count("disconnected"))
    (line,) = serving.notices
    assert "protocol" in line


def test_empty_messages_are_passed_over() -> None:
    with Serving(Book()) as serving:
        client = RawClient(serving.port)
        for number in range(2):
            for empty, opcode in (("", ABNF.OPCODE_TEXT), (b"", ABNF.OPCODE_BINARY), ("4", ABNF.OPCODE_TEXT)):
                client.websocket.send(empty, opcode)
            client.tell(fields(number))
            assert client.command() == steered(Steer(-steering(number), 0.5))
        client.close()
    assert serving.notices == []


def test_broken_frames_and_endless_messages_are_hung_up_on() -> None:
    with Serving(Book()) as serving:
        for _ in range(2):
            client = RawClient(serving.port)
            client.stream.sendall(b"\x81\x05hello")  # not masked
            client.until_hung_up()
            client = RawClient(serving.port)
            with contextlib.suppress(ConnectionError):
                for start in range(0, MAX_MESSAGE_BYTES + 2, 1 << 20):
                    opcode = ABNF.OPCODE_CONT if start else ABNF.OPCODE_TEXT
                    client.websocket.send_frame(ABNF.create_frame(b"4" * (1 << 20), opcode, 0))
            client.until_hung_up()
        assert tell(serving.port, range(3))
    assert len(serving.notices) == 2
    assert "websocket protocol" in serving.notices[0]
    assert "too much" in serving.notices[1]


def get(port: int, path: str) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=PATIENCE_S) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


def send_bytes(port: int, data: bytes) -> None:
    with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as stream:
        stream.sendall(data)
        with contextlib.suppress(ConnectionError):
            while stream.recv(1000):
                pass


def test_a_browser_is_reported_what_the_port_is_for() -> None:
    with Serving(Book()) as serving:
        status, text = get(serving.port, "/")
        assert (status, text.count("\n")) == (200, 1)
        assert "autonomous mode" in text
        assert get(serving.port, "/favicon.ico") == (404, text)
    (line,) = serving.notices
    assert "browser" in line
    assert "autonomous mode" in line


OLD_PYTHON = "/socket.io/?EIO=3&transport=polling"
KNOCKS: dict[str, tuple[Callable[[int], object], str]] = {
    "a client of another version": (lambda port: get(port, OLD_PYTHON), "refused.*python-socketio 5"),
    "another transport": (lambda port: get(port, "/socket.io/?EIO=4&transport=x"), "refused.*python-socketio 5"),
    "bytes": (lambda port: send_bytes(port, b"\x00\x01SSH-2.0\r\n\r\n"), "HTTP.*another port"),
    "a request that is none": (lambda port: send_bytes(port, b"GET\r\n\r\n"), "HTTP.*another port"),
    "TLS": (lambda port: send_bytes(port, b"\x16\x03\x01\x02\x00\x01\x00\x01"), "HTTP.*another port"),
}


@pytest.mark.parametrize(("knock", "line"), KNOCKS.values(), ids=KNOCKS)
def test_who_speaks_something_else_costs_one_line_that_reports_what_to_do(
    knock: Callable[[int], object], line: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with Serving(Book()) as serving:
        for _ in range(3):
            knock(serving.port)
        wait_until(lambda: len(serving.notices) > 0)
        assert tell(serving.port, range(2))
    assert len(serving.notices) == 1
    assert re.search(line, serving.notices[0])
    assert capfd.readouterr() == ("", "")  # no traceback either


def ask(serving: Serving, count: int, seed: int) -> None:
    """Tell `count` malformed telemetries and a good one after each; every one gets one command."""
    chance = random.Random(seed)
    client = RawClient(serving.port, "40")
    for number in range(count):
        data = malformed(chance)
        if chance.random() < 0.1:  # as a client sends that has bytes in its telemetry
            client.websocket.send('451-["telemetry",' + data + ',{"_placeholder":true,"num":0}]')
            client.websocket.send_binary(b"\xff\xd8\xff")
        else:
            client.websocket.send('42["telemetry",' + data + "]")
        client.tell(fields(number))
        name, command = client.command()
        assert name == ("manual" if data == "null" else "steer"), data[:80]
        assert set(command) <= {"steering_angle", "throttle"}
        assert client.command() == steered(Steer(-steering(number), 0.5))
    client.close()


class Reasons(Book):
    """Writes down why telemetries cannot be used."""

    def __init__(self) -> None:
        super().__init__()
        self.reasons: list[str] = []

    def telemetry(self, sid: str, data: object, received_s: float) -> Answer:
        try:
            parse_telemetry(data)
        except TelemetryError as error:
            self.reasons.append(str(error))
        return super().telemetry(sid, data, received_s)


def test_the_reason_is_plain_where_a_telemetry_is_no_object() -> None:
    reasons = {
        '{"speed": 9.0': "telemetry is not JSON",
        "'x'": "telemetry is not JSON",
        "[" * 200_000 + "]" * 200_000: "telemetry is not JSON",  # 3.13 takes it from 5,000 deep
        json.dumps(json.dumps(fields(0))): "not an object but a string (send the object, not a string of JSON)",
        '"not JSON"': "not an object but a string",
        "[1]": "not an object but a list",
        "true": "not an object but true or false",
        json.dumps(fields(0, image=7)): "image is not a string but a number",
        json.dumps(fields(0, speed={})): "speed is not a number but an object",
    }
    book = Reasons()
    with Serving(book) as serving:
        client = RawClient(serving.port)
        for data in reasons:
            client.websocket.send(f'42["telemetry",{data}]')
            assert client.command() == steered(UNUSED)
        client.close()
    assert book.reasons == list(reasons.values())


def test_hundreds_of_malformed_telemetries_are_each_answered_once() -> None:
    with Serving(Book()) as serving:
        ask(serving, 600, seed=7)
    assert serving.notices == []


@pytest.mark.parametrize("first", [Steer(0.0, 0.0), "manual"])
@pytest.mark.parametrize("hello", [(), ("40",)], ids=["old client", "modern client"])
def test_a_first_command_goes_to_a_simulator_that_waits_for_one(
    first: Steer | Literal["manual"], hello: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A classic server sends a steer when a client connects. For the real simulator each is one telemetry more in
    flight for ever."""
    monkeypatch.setattr(telemetry_server, "FIRST_COMMAND_S", PATIENCE_S)
    with Serving(Book(), first_command=first) as serving:
        busy = RawClient(serving.port, *hello)
        busy.tell(fields(0))
        assert busy.command() == steered(Steer(-steering(0), 0.5))
        monkeypatch.setattr(telemetry_server, "FIRST_COMMAND_S", 0.0)
        waiting = RawClient(serving.port, *hello)
        name, command = waiting.command()
        assert (name, command) == (("manual", {}) if first == "manual" else steered(Steer(0.0, 0.0)))
        waiting.tell(fields(1))
        assert waiting.command() == steered(Steer(-steering(1), 0.5))
        busy.tell(fields(2))
        assert busy.command() == steered(Steer(-steering(2), 0.5))
        for client in (busy, waiting):
            client.close()
