"""Whether a person's rows are recorded, and why some were not."""

from __future__ import annotations

from recorder.teleop.seat import Control
from recorder.teleop.wheel import Request, Wheel


class Recording:
    """Begins off. `gap_why` is empty where no row is missing on purpose."""

    def __init__(self, wheel: Wheel) -> None:
        self._wheel = wheel
        self.is_on = False
        self.gap_why = ""
        """Why the rows before the next one were not recorded."""

    def heed(self, request: Request) -> None:
        """Begin or pause, if the person asks for that."""
        if request.kind == "record":
            self.is_on = True
            self._wheel.event("recording")
        elif request.kind == "pause":
            self.is_on = False
            self.gap_why = self.gap_why or "the person paused"
            self._wheel.event("recording is paused")

    def takes_row(self, control: Control) -> bool:
        """True if a row of these controls is recorded: of a person who is there."""
        if self.is_on and control.is_absent:
            self.gap_why = self.gap_why or "nobody was at the wheel"
        return self.is_on and not control.is_absent
