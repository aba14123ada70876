"""As many telemetries are in flight after a command that answered none as before it; no client waits for ever."""

from __future__ import annotations

import random
import socket
import threading
import time
from collections import deque
from typing import Any

import pytest

from recorder.server import in_flight as flight
from recorder.server import telemetry_server
from recorder.server.in_flight import MAX_HOLD_S, MAX_HOLDS, MAX_IN_FLIGHT, RETRY_S, InFlight
from recorder.server.telemetry_server import TICK_S, Answer, Steer, TelemetryServer
from tests.helpers.driving import PATIENCE_S
from tests.helpers.serving import Book, RawClient, Serving, fields, steered, steering
from tests.helpers.waiting import wait_until

PUSHED = Steer(0.875, 0.125)


class Pushing(Book):
    """Sends a command that answers no telemetry whenever a test wants one; keeps how many are in flight."""

    server: TelemetryServer

    def __init__(self) -> None:
        super().__init__()
        self.sid = ""
        self.in_flight: list[int] = []
        self._due = threading.Event()

    def push(self) -> None:
        self._due.set()

    def telemetry(self, sid: str, data: object, received_s: float) -> Answer:
        self.sid = sid
        self.in_flight.append(self.server.in_flight(sid))
        return super().telemetry(sid, data, received_s)

    def tick(self) -> None:
        super().tick()
        if self._due.is_set():
            self._due.clear()
            self.server.push(self.sid, PUSHED)


class Loop:
    """A simulator that sends telemetries unasked when it begins, and then one for each command."""

    def __init__(self, port: int, in_flight: int) -> None:
        self.client = at_once(RawClient(port))
        self.sent = 0
        self.tell(in_flight)

    def tell(self, count: int = 1) -> None:
        for _ in range(count):
            self.client.tell(fields(self.sent))
            self.sent += 1

    def expect_answer_to(self, number: int) -> None:
        assert self.client.command() == answer_to(number)


def pushed_loop(book: Pushing, in_flight: int) -> Loop:
    """A simulator that has all its answers, and then one command more."""
    loop = Loop(book.server.port, in_flight)
    for number in range(in_flight):
        loop.expect_answer_to(number)
    book.push()
    assert loop.client.command() == steered(PUSHED)
    return loop


def at_once(client: RawClient) -> RawClient:
    """What it sends is there when it has sent it."""
    client.stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return client


def answer_to(number: int) -> tuple[str, Any]:
    return steered(Steer(-steering(number), 0.5))


@pytest.mark.usefixtures("patient")
def test_a_client_is_not_answered_after_its_ping_timeout(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else it would count as another simulator when it connects again."""
    book = Pushing()
    with serving(book):
        loop = pushed_loop(book, 1)
        loop.tell()
        wait_until(lambda: has_held(book))
        client = book.server._client(book.sid)
        assert client is not None
        client.connection.last_ping = time.time() - 1000  # it was suspended
        wait_until(lambda: "disconnected" in book.calls)
        for name in ("MIN_HOLD_S", "MAX_HOLD_S", "FIRST_HOLD_S"):
            monkeypatch.setattr(flight, name, 0.0)
        ticks = book.ticks
        wait_until(lambda: book.ticks > ticks + 2)
        loop.client.vanish()
    assert book.calls[-1] == "disconnected"
    assert book.left == [fields(1)]


def has_held(book: Pushing) -> bool:
    client = book.server._client(book.sid)
    return client is not None and client.in_flight.holds


def serving(book: Pushing, **options: Any) -> Serving:
    made = Serving(book, **options)
    book.server = made.server
    return made


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is held is held until the next one comes, however long others have the processor."""
    for name in ("MIN_HOLD_S", "MAX_HOLD_S", "FIRST_HOLD_S"):
        monkeypatch.setattr(flight, name, PATIENCE_S)


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("in_flight", [1, 2])
def test_a_pause_leaves_as_many_in_flight_as_before(in_flight: int) -> None:
    """The simulator pauses with all answers in hand, and is sent one command more."""
    book = Pushing()
    with serving(book):
        loop = pushed_loop(book, in_flight)
        loop.tell(in_flight + 1)  # it goes on
        for number in range(in_flight + 1, 2 * in_flight + 1):  # all but the first
            loop.expect_answer_to(number)
        loop.tell()
        loop.expect_answer_to(2 * in_flight + 1)
        loop.client.close()
    assert book.left == [fields(in_flight)]


def test_the_command_that_a_silent_client_needed_costs_it_no_answer() -> None:
    """It had lost all telemetries: one is in flight again, which is held for a moment, and answered."""
    book = Pushing()
    with serving(book):
        loop = pushed_loop(book, 2)
        for number in range(2, 6):
            loop.tell()
            loop.expect_answer_to(number)
        loop.client.close()
    assert book.left == []


@pytest.mark.usefixtures("patient")
def test_a_client_that_waits_for_no_answer_misses_one_for_each_command() -> None:
    book = Pushing()
    with serving(book):
        loop = Loop(book.server.port, 1)
        loop.expect_answer_to(0)
        for _ in range(3):
            book.push()
            assert loop.client.command() == steered(PUSHED)
        loop.tell(4)
        loop.expect_answer_to(4)
        loop.client.close()
    assert book.left == [fields(number) for number in (1, 2, 3)]  # one for each command


@pytest.mark.usefixtures("patient")
def test_a_burst_leaves_two_in_flight_and_all_reach_the_handler() -> None:
    """A simulator stood still while its server restarted: it sends one telemetry for each command that waited."""
    is_handling, goes_on = threading.Event(), threading.Event()

    class Slow(Pushing):
        def telemetry(self, sid: str, data: object, received_s: float) -> Answer:
            is_handling.set()
            assert goes_on.wait(PATIENCE_S)
            return super().telemetry(sid, data, received_s)

    book = Slow()
    with serving(book):
        loop = Loop(book.server.port, 1)
        assert is_handling.wait(PATIENCE_S)
        loop.tell(6)
        goes_on.set()
        for number in (0, 6):
            loop.expect_answer_to(number)
        for number in range(7, 12):  # one for each answer, as ever
            loop.tell()
            loop.expect_answer_to(number)
        assert book.server.in_flight(book.sid) <= 2
        loop.client.close()
    assert book.left == [fields(number) for number in range(1, 6)]


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("hangs_up", [True, False])
def test_a_held_telemetry_reaches_the_handler_when_its_client_goes(hangs_up: bool) -> None:
    book = Pushing()
    with serving(book) as running:
        loop = pushed_loop(book, 1)
        loop.tell()
        wait_until(lambda: has_held(book))
        if hangs_up:
            loop.client.vanish()
            wait_until(lambda: "disconnected" in book.calls)
        else:
            running.stop()
            loop.client.until_hung_up()
    assert book.left == [fields(1)]
    assert book.calls.index("unanswered") < book.calls.index("disconnected" if hangs_up else "final_command")


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("in_flight", [1, 2])
def test_a_first_command_is_paid_back_and_reported(in_flight: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(telemetry_server, "FIRST_COMMAND_S", 0.0)
    book = Pushing()
    with serving(book, first_command=PUSHED):
        loop = Loop(book.server.port, 0)
        assert loop.client.command() == steered(PUSHED)
        loop.tell(in_flight + 1)  # its own, which were slow, and that of the command
        for number in range(1, in_flight + 1):
            loop.expect_answer_to(number)
        loop.client.close()
    assert book.left == [fields(0)]
    assert book.calls.count("first_command_sent") == 1


@pytest.mark.usefixtures("patient")
def test_the_number_in_flight_is_counted() -> None:
    """The handler takes its time for the first telemetry: the second one comes before the first is answered."""
    is_sent = threading.Event()

    class Slow(Pushing):
        def telemetry(self, sid: str, data: object, received_s: float) -> Answer:
            assert is_sent.wait(PATIENCE_S)
            return super().telemetry(sid, data, received_s)

    book = Slow()
    with serving(book):
        loop = Loop(book.server.port, 2)
        is_sent.set()
        for number in range(2):
            loop.expect_answer_to(number)
        book.push()
        assert loop.client.command() == steered(PUSHED)
        assert book.server.in_flight(book.sid) == 3
        loop.tell(3)
        for number in (3, 4):
            loop.expect_answer_to(number)
        assert book.server.in_flight(book.sid) == 2
        loop.client.close()
    assert book.in_flight[1:] == [2, 2, 2]


def test_what_was_sent_and_is_not_handled_yet_is_no_silence() -> None:
    unread: list[bool] = []
    is_ticking, is_sent = threading.Event(), threading.Event()

    class Ticking(Pushing):
        def tick(self) -> None:
            super().tick()
            if self.sid and not unread:
                unread.append(self.server.has_unread(self.sid))
                is_ticking.set()
                assert is_sent.wait(PATIENCE_S)
                unread.append(self.server.has_unread(self.sid))

    book = Ticking()
    with serving(book):
        loop = Loop(book.server.port, 1)
        loop.expect_answer_to(0)
        assert is_ticking.wait(PATIENCE_S)
        loop.tell()
        is_sent.set()
        loop.expect_answer_to(1)
        loop.client.close()
    assert unread == [False, True]


class Traffic:
    """A client, a server, and what is under way between them."""

    def __init__(self, in_flight: int) -> None:
        self.flight: InFlight[int] = InFlight()
        self.sent = in_flight
        self.to_server, self.read = deque(range(in_flight)), deque[int]()
        self.held: int | None = None
        self.to_client = 0  # commands
        self.now_s = 0.0
        self.answered: list[int] = []
        self.left: list[int] = []
        self.lost: list[int] = []

    @property
    def under_way(self) -> int:
        return len(self.to_server) + len(self.read) + (self.held is not None) + self.to_client

    def react(self, commands: int) -> None:
        """The client gets commands, and sends a telemetry for each."""
        for _ in range(min(commands, self.to_client)):
            self.to_client -= 1
            self.to_server.append(self.sent)
            self.sent += 1

    def lose(self) -> None:
        """The client fails to send a telemetry. It has another one under way."""
        if self.to_server and self.under_way > 1:
            self.lost.append(self.to_server.pop())

    def arrive(self, count: int) -> None:
        self.read.extend(self.to_server.popleft() for _ in range(min(count, len(self.to_server))))

    def handle(self, meanwhile: int) -> None:
        """The server handles a telemetry; more arrive before its answer leaves."""
        if not self.read:
            return
        telemetry, self.held = self.read.popleft(), None
        unanswered, due = self.flight.take(telemetry, len(self.read), self.now_s)
        self.left += unanswered
        if due is None:
            self.held = telemetry if self.flight.holds else None
            return
        self.arrive(meanwhile)
        self._answer(due)
        self.flight.answered(len(self.read))

    def tick(self) -> None:
        self.now_s += TICK_S
        due = self.flight.overdue(self.now_s, has_unread=bool(self.read))
        if due is not None:
            self.held = None
            self._answer(due)

    def push(self) -> None:
        self.flight.pushed(self.now_s)
        self.to_client += 1

    def _answer(self, telemetry: int) -> None:
        self.answered.append(telemetry)
        self.to_client += 1


def any_traffic(chance: random.Random) -> Traffic:
    traffic = Traffic(chance.randint(1, 7))
    delays = [chance.random() for _ in range(3)]  # of the client, the network and the server
    for _ in range(chance.randrange(400)):
        if chance.random() > delays[0]:
            traffic.react(chance.randint(1, 4))
        if chance.random() > delays[1]:
            traffic.arrive(chance.randint(1, 4))
        if chance.random() > delays[2]:
            traffic.handle(chance.randrange(4))
        if chance.random() < 0.3:
            traffic.tick()
        if chance.random() < 0.02:
            traffic.push()
        if chance.random() < 0.05:
            traffic.lose()
        assert traffic.under_way, "the client waits for ever"
        assert traffic.flight.owed >= 0
    return traffic


@pytest.mark.parametrize("seed", range(60))
def test_something_is_always_under_way_and_the_loop_goes_on(seed: int) -> None:
    traffic = any_traffic(random.Random(seed))
    answers = len(traffic.answered)
    for _ in range(round((MAX_HOLD_S + RETRY_S) * (MAX_HOLDS + 1) / TICK_S)):  # all come quickly from now on
        traffic.react(9)
        traffic.arrive(9)
        while traffic.read:
            traffic.handle(0)
        traffic.tick()
    assert len(traffic.answered) > answers + 10
    assert 1 <= traffic.under_way <= MAX_IN_FLIGHT
    waiting = {*traffic.to_server, *traffic.read, *([] if traffic.held is None else [traffic.held])}
    assert sorted([*traffic.answered, *traffic.left, *traffic.lost, *waiting]) == list(
        range(traffic.sent)
    )  # each once
