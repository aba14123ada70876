"""Counts the telemetries of a connection that are in flight, and chooses one to leave unanswered.

A simulator sends one telemetry for each command. A command that answers no telemetry adds one in flight for good:
every later answer comes one telemetry later. After this command, the next telemetry is held. If another one comes,
at least two were in flight, and the held one is left unanswered. If none comes, the held one is answered, so that
the simulator does not wait for ever.

The protocol begins with two telemetries in flight. If more are unanswered at once, those beyond two are left
unanswered like those of such commands: a simulator that stood still while its server restarted sends one for each
command of both servers.
"""

from __future__ import annotations

import time
from collections import deque
from typing import Final, Generic, TypeVar

MAX_TICK_S: Final = 0.2  # the most that one tick adds: twice the regular time between ticks
MIN_HOLD_S: Final = 0.1
MAX_HOLD_S: Final = 1.0
FIRST_HOLD_S: Final = 0.5  # the holding time until intervals are measured
INTERVALS: Final = 8  # a telemetry is held for twice the longest of the last intervals
MAX_HOLDS: Final = 2  # after this many holds without another telemetry, nothing else is in flight
RETRY_S: Final = 1.0  # between two holds
RECENT: Final = 250  # telemetries that determine the number in flight
MAX_IN_FLIGHT: Final = 2  # Udacity's simulator begins with them
T = TypeVar("T")


class RunningClock:
    """Seconds for which this process ran, counted by its ticks.

    A tick is late if the process was stopped, the machine slept, or other processes ran. Nothing was read then, so
    this time is not a client's silence: a late tick adds at most `MAX_TICK_S`.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self._ticked_s = time.monotonic()

    def tick(self) -> float:
        now_s = time.monotonic()
        self.seconds += min(now_s - self._ticked_s, MAX_TICK_S)
        self._ticked_s = now_s
        return self.seconds


class InFlight(Generic[T]):
    """Counts telemetries and commands. All times are a `RunningClock`'s."""

    def __init__(self) -> None:
        self.owed = 0  # telemetries in flight that are too many
        self._held: T | None = None
        self._held_s = 0.0
        self._holds = 0  # without another telemetry, since the last command that answered none
        self._hold_from_s = 0.0
        self._last_s: float | None = None
        self._intervals: deque[float] = deque(maxlen=INTERVALS)
        self._unasked: deque[int] = deque(maxlen=RECENT)  # unanswered at once, without the owed ones

    @property
    def count(self) -> int:
        """The telemetries in flight that counting proves: the most that were recently unanswered at once, plus the
        owed ones."""
        return max(1, max(self._unasked, default=1) + self.owed)

    @property
    def holds(self) -> bool:
        return self._held is not None

    def pushed(self, now_s: float) -> None:
        """Note a command that answers no telemetry."""
        self.owed, self._holds, self._hold_from_s = self.owed + 1, 0, now_s

    def answered(self, waiting: int) -> None:
        """Note an answer that left while `waiting` more telemetries had come: they do not answer it."""
        unanswered = 1 + waiting
        if unanswered - self.owed > MAX_IN_FLIGHT:
            self.owed, self._holds = unanswered - MAX_IN_FLIGHT, 0
        self._note(unanswered)

    def take(self, telemetry: T, waiting: int, now_s: float) -> tuple[list[T], T | None]:
        """Take a telemetry; returns those to leave unanswered, and the one to answer now.

        `waiting`: how many more have come, and will be taken next.
        """
        if self._last_s is not None and now_s - self._last_s < MAX_HOLD_S:
            self._intervals.append(now_s - self._last_s)
        self._last_s = now_s
        held, self._held = self._held, None
        self._note(1 + waiting + (held is not None))
        unanswered = [] if held is None else [held]
        self.owed -= len(unanswered)
        if self.owed and waiting:
            self.owed -= 1
            return [*unanswered, telemetry], None
        if self.owed and now_s >= self._hold_from_s:
            self._held, self._held_s = telemetry, now_s
            return unanswered, None
        return unanswered, telemetry

    def release(self) -> T | None:
        """The held telemetry, which is not answered any more."""
        held, self._held = self._held, None
        return held

    def overdue(self, now_s: float, *, has_unread: bool) -> T | None:
        """The held telemetry, if it has to be answered now. With `has_unread`, unread data has come, and the
        holding time is doubled."""
        if self._held is None or now_s - self._held_s < self._hold_s * (1 + has_unread):
            return None
        held, self._held = self._held, None
        self._holds += 1
        self._hold_from_s = now_s + RETRY_S
        if self._holds >= MAX_HOLDS:  # the other telemetries were lost, and the command was needed
            self.owed = 0
            self._unasked.clear()
        return held

    def _note(self, unanswered: int) -> None:
        self._unasked.append(min(unanswered - self.owed, MAX_IN_FLIGHT))

    @property
    def _hold_s(self) -> float:
        if not self._intervals:
            return FIRST_HOLD_S
        return min(max(2 * max(self._intervals), MIN_HOLD_S), MAX_HOLD_S)
