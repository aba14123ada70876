"""The last rows of a drive, which the person may call bad: nobody learns from them."""

from __future__ import annotations

from collections import deque
from typing import Final

from common.errors import counted
from recorder.log.bad_rows import driven_badly
from recorder.log.tags import EXCLUDE, Tag
from recorder.teleop.messages import MAX_BAD_S
from recorder.teleop.wheel import Wheel

_MAX_BAD_NS: Final = round(MAX_BAD_S * 1e9)
_MAX_ROWS: Final = 6000  # also of a clock that stands


class LastRows:
    """The rows of the last minute, by the clock of the drive."""

    def __init__(self, wheel: Wheel) -> None:
        self._wheel = wheel
        self._rows: deque[tuple[int, int]] = deque(maxlen=_MAX_ROWS)  # the time and the number of each
        self.tags: list[Tag] = []
        """Of rows that were driven badly."""

    def add(self, time_ns: int, row: int) -> None:
        self._rows.append((time_ns, row))
        while not 0 <= time_ns - self._rows[0][0] <= _MAX_BAD_NS:  # too old, or of another drive
            self._rows.popleft()

    def exclude(self, seconds: float) -> list[str]:
        """Tag the rows of the last seconds, and show that on the page; the events of that, for the log."""
        last_ns = self._rows[-1][0] if self._rows else 0
        rows = [row for time_ns, row in self._rows if last_ns - time_ns < round(seconds * 1e9)]
        if not rows:
            return []
        self.tags.append(Tag(rows[0], rows[-1], EXCLUDE))
        self._wheel.event(f"{counted(len(rows), 'row')} will not be learnt from")
        return [driven_badly(rows[0], rows[-1])]
