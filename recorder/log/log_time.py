"""The log times of what comes live: never the same, never back."""

from __future__ import annotations

import time
from typing import Final

from recorder.rows.row_quality import GAP_S

LONGEST_STEP_S: Final = 60.0
"""Simulated time that jumps farther than this from one telemetry to the next is another clock."""
STANDS_S: Final = 1.0
"""So long a simulated clock may stand, or only go back, while this computer's runs on; then it is not used."""
BREAK_NS: Final = round(1.5 * GAP_S * 1e9)  # rows that far apart belong to two drives


class StandingClock:
    """Finds out whether a simulated clock stands, or only goes back, for `STANDS_S` of this computer's.

    Pauses (`recorder.rows.row_quality.GAP_S`) do not count: a simulator in its menu stops its clock. One that
    stood is not trusted any more.
    """

    def __init__(self) -> None:
        self.stands = False
        self.stood_s = 0.0  # the time that it has stood now, by this computer's clock
        self._now_s = 0.0
        self._simulated_s: float | None = None

    def note(self, now_s: float, simulated_s: float | None) -> bool:
        """Note the simulated clock's time, None without one, at `now_s` of this computer's. Returns `stands`."""
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

    A row's is that of the simulated clock, from the moment at which its first telemetry came; where no such clock
    is there, or it stands, the moment at which its telemetry came. Rows on either side of another clock, or of one
    that begins anew, are so far apart that nobody takes them for neighbours.

    Moments are nanoseconds of `time.perf_counter_ns`: the wall clock is read once, so that setting it while
    the car drives moves no row.
    """

    def __init__(self) -> None:
        self._wall_ns = time.time_ns() - time.perf_counter_ns()
        self._shift_ns = self._wall_ns  # from the clock in use to log time
        self._simulated_ns: int | None = None  # of the last row; None: the clock in use is ours
        self._last_ns = 0
        self._has_rows = False
        self._standing = StandingClock()

    @property
    def stands(self) -> bool:
        """True once the simulated clock was found not to run."""
        return self._standing.stands

    def row(self, received_ns: int, simulated_s: float | None) -> int:
        """The log time of a row; `simulated_s` is what the simulated clock shows there."""
        if self._standing.note(received_ns / 1e9, simulated_s):
            simulated_s = None
        simulated_ns = None if simulated_s is None else round(simulated_s * 1e9)
        clock_ns = received_ns if simulated_ns is None else simulated_ns
        if self._is_another(simulated_ns):
            earliest_ns = self._last_ns + (BREAK_NS if self._has_rows else 1)
            self._shift_ns = max(self._wall_ns + received_ns, earliest_ns) - clock_ns
        self._simulated_ns = simulated_ns
        self._has_rows = True
        return self._after_last(clock_ns + self._shift_ns)

    def event(self, happened_ns: int) -> int:
        """The log time of an event: right after the last row, where the clock is a simulated one."""
        return self._after_last(happened_ns + self._shift_ns if self._simulated_ns is None else 0)

    def _is_another(self, simulated_ns: int | None) -> bool:
        if simulated_ns is None or self._simulated_ns is None:
            return simulated_ns is not self._simulated_ns
        return not 0 <= simulated_ns - self._simulated_ns <= LONGEST_STEP_S * 1e9

    def _after_last(self, time_ns: int) -> int:
        self._last_ns = max(time_ns, self._last_ns + 1)
        return self._last_ns
