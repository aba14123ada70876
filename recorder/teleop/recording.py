"""Which rows of a person's drive are recorded, why some are not, and which are excluded from training."""

from __future__ import annotations

from collections import deque
from typing import Final

from common.errors import counted
from recorder.log.tags import EXCLUDE, Tag, driven_badly
from recorder.teleop.messages import MAX_BAD_S
from recorder.teleop.seat import Control
from recorder.teleop.wheel import Request, Wheel

_MAX_BAD_NS: Final = round(MAX_BAD_S * 1e9)
_MAX_ROWS: Final = 6000  # also if the clock stands still


class LastRows:
    """The rows of the last minute, by the clock of the drive."""

    def __init__(self, wheel: Wheel) -> None:
        self._wheel = wheel
        self._rows: deque[tuple[int, int]] = deque(maxlen=_MAX_ROWS)  # time and number
        self.tags: list[Tag] = []  # for badly driven rows

    def add(self, time_ns: int, row: int) -> None:
        self._rows.append((time_ns, row))
        while not 0 <= time_ns - self._rows[0][0] <= _MAX_BAD_NS:  # too old, or of another drive
            self._rows.popleft()

    def exclude(self, seconds: float) -> list[str]:
        """Tag the rows of the last seconds, and tell the page; returns the events for the log."""
        last_ns = self._rows[-1][0] if self._rows else 0
        rows = [row for time_ns, row in self._rows if last_ns - time_ns < round(seconds * 1e9)]
        if not rows:
            return []
        self.tags.append(Tag(rows[0], rows[-1], EXCLUDE))
        self._wheel.event(f"{counted(len(rows), 'row')} will not be learnt from")
        return [driven_badly(rows[0], rows[-1])]


class Recording(LastRows):
    """The recording of a drive without a network. It begins off, and records only while the person is there."""

    def __init__(self, wheel: Wheel) -> None:
        super().__init__(wheel)
        self.is_on = False
        self.gap_why = ""  # why the rows before the next one were not recorded; empty if none is missing

    def handle(self, request: Request) -> list[str]:
        """Begin, pause, or exclude the last rows, as the person requests; returns the events for the log."""
        match request.kind:
            case "record":
                self.is_on = True
                self._wheel.event("recording")
            case "pause":
                self.is_on = False
                self.gap_why = self.gap_why or "the person paused"
                self._wheel.event("recording is paused")
            case "bad":
                return self.exclude(request.seconds)
        return []

    def takes_row(self, control: Control) -> bool:
        """True if a row of these controls is recorded."""
        if self.is_on and control.is_absent:
            self.gap_why = self.gap_why or "nobody was at the wheel"
        return self.is_on and not control.is_absent

    def add(self, time_ns: int, row: int) -> None:
        """Note a row that was recorded."""
        super().add(time_ns, row)
        self.gap_why = ""
