"""Log times of live rows and events, strictly ascending."""

from __future__ import annotations

import time
from typing import Final

from recorder.rows.row_quality import GAP_S

LONGEST_STEP_S: Final = 60.0
"""A longer jump of simulated time between two telemetries means another clock."""
STANDS_S: Final = 1.0
"""A simulated clock that stands, or goes back, for this time of this computer's clock is not used any more."""
BREAK_NS: Final = round(1.5 * GAP_S * 1e9)  # between rows of two drives


class StandingClock:
    """Recognises a simulated clock that stands, or goes back, for `STANDS_S` of this computer's clock.

    Pauses (`recorder.rows.row_quality.GAP_S`) do not count: a simulator in its menu stops its clock.
    """

    def __init__(self) -> None:
        self.stands = False  # stays True
        self.stood_s = 0.0  # how long it has stood until now, by this computer's clock
        self._now_s = 0.0
        self._simulated_s: float | None = None

    def note(self, now_s: float, simulated_s: float | None) -> bool:
        """Note the simulated clock's time (None: no clock) at `now_s` of this computer's clock. Returns
        `stands`."""
        passed_s, self._now_s = now_s - self._now_s, now_s
        last_s, self._simulated_s = self._simulated_s, simulated_s
        if simulated_s is None or last_s is None or simulated_s > last_s:
            self.stood_s = 0.0
        elif 0 < passed_s <= GAP_S:
            self.stood_s += passed_s
        self.stands |= self.stood_s >= STANDS_S
        return self.stands


class LogClock:
    """Gives every row and every event its time.

    A row's time is the simulated clock's, counted from the arrival of the first telemetry. Without this clock,
    or if it stands, it is the telemetry's time of arrival. If the clock changes or starts again, or a drive has
    ended, the rows before and after are at least `BREAK_NS` apart.

    Arguments are nanoseconds of `time.perf_counter_ns`. The wall clock is read only once, so that a change of it
    during a drive moves no row.
    """

    def __init__(self) -> None:
        self._wall_ns = time.time_ns() - time.perf_counter_ns()
        self._shift_ns = self._wall_ns  # from the clock in use to log time
        self._simulated_ns: int | None = None  # of the last row; None: this computer's clock is in use
        self._last_ns = 0
        self._has_rows = False
        self._begins_drive = False
        self._standing = StandingClock()

    @property
    def stands(self) -> bool:
        return self._standing.stands

    def end_drive(self) -> None:
        """Note that the next row is of another car."""
        self._begins_drive = True

    def row(self, received_ns: int, simulated_s: float | None) -> int:
        """The log time of a row. `simulated_s`: the simulated clock's time there."""
        if self._standing.note(received_ns / 1e9, simulated_s):
            simulated_s = None
        simulated_ns = None if simulated_s is None else round(simulated_s * 1e9)
        clock_ns = received_ns if simulated_ns is None else simulated_ns
        if self._begins_drive or self._is_another(simulated_ns):
            earliest_ns = self._last_ns + (BREAK_NS if self._has_rows else 1)
            self._shift_ns = max(self._wall_ns + received_ns, earliest_ns) - clock_ns
        self._simulated_ns = simulated_ns
        self._has_rows, self._begins_drive = True, False
        return self._after_last(clock_ns + self._shift_ns)

    def event(self, happened_ns: int) -> int:
        """The log time of an event; with a simulated clock, right after the last row."""
        return self._after_last(happened_ns + self._shift_ns if self._simulated_ns is None else 0)

    def _is_another(self, simulated_ns: int | None) -> bool:
        if simulated_ns is None or self._simulated_ns is None:
            return simulated_ns is not self._simulated_ns
        return not 0 <= simulated_ns - self._simulated_ns <= LONGEST_STEP_S * 1e9

    def _after_last(self, time_ns: int) -> int:
        self._last_ns = max(time_ns, self._last_ns + 1)
        return self._last_ns
