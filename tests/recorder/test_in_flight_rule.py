"""However messages are delayed, gathered and lost, no client that still has one under way waits for ever.

The client sends its next telemetry only after a command, as Udacity's simulator does. Time is simulated.
"""

from __future__ import annotations

import random
from collections import deque

import pytest

from recorder.server.in_flight import MAX_HOLD_S, MAX_HOLDS, MAX_IN_FLIGHT, RETRY_S, InFlight
from recorder.server.telemetry_server import TICK_S


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
