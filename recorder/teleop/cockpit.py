"""The cockpit of any drive with a person: the controls in force, the page's requests, the rows that are kept, and
the frames that the page shows."""

from __future__ import annotations

import time
from collections import deque
from typing import Any, Final

from common.errors import counted
from recorder.log.tags import EXCLUDE, Tag, driven_badly
from recorder.server.telemetry import Telemetry
from recorder.teleop.frame_state import FrameState, RateMeter
from recorder.teleop.seat import MAX_BAD_S, Control
from recorder.teleop.wheel import Request, Wheel

_MAX_BAD_NS: Final = round(MAX_BAD_S * 1e9)
_MAX_ROWS: Final = 6000  # also if the clock stands still


class Recording:
    """Which rows of a drive are recorded, why some are not, and which are excluded from training. Without a
    network, it begins off, and records only while the person is there."""

    def __init__(self, wheel: Wheel, *, is_on: bool = False) -> None:
        self._wheel = wheel
        self._rows: deque[tuple[int, int]] = deque(maxlen=_MAX_ROWS)  # of the last minute: time and number
        self.is_on = is_on
        self.gap_why = ""  # why the rows before the next one were not recorded; empty if none is missing
        self.tags: list[Tag] = []  # for badly driven rows

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
                return self._exclude(request.seconds)
        return []

    def takes_row(self, control: Control) -> bool:
        """True if a row of these controls is recorded."""
        if self.is_on and control.is_absent:
            self.gap_why = self.gap_why or "nobody was at the wheel"
        return self.is_on and not control.is_absent

    def add(self, time_ns: int, row: int) -> None:
        """Note a row that was recorded, with its time by the drive's clock."""
        self.gap_why = ""
        self._rows.append((time_ns, row))
        while not 0 <= time_ns - self._rows[0][0] <= _MAX_BAD_NS:  # too old, or of another drive
            self._rows.popleft()

    def _exclude(self, seconds: float) -> list[str]:
        """Tag the rows of the last seconds, and tell the page; returns the events for the log."""
        last_ns = self._rows[-1][0] if self._rows else 0
        rows = [row for time_ns, row in self._rows if last_ns - time_ns < round(seconds * 1e9)]
        if not rows:
            return []
        self.tags.append(Tag(rows[0], rows[-1], EXCLUDE))
        self._wheel.event(f"{counted(len(rows), 'row')} will not be learnt from")
        return [driven_badly(rows[0], rows[-1])]


class Cockpit:
    """What all drives with a person share. A drive reads the car, sends commands, and shows its frames."""

    def __init__(self, wheel: Wheel, hold_mph: float, *, has_network: bool = False) -> None:
        """`hold_mph`: the speed that the page offers to hold."""
        self.wheel = wheel
        self.recording = Recording(wheel, is_on=has_network)
        self.control = Control()  # in force
        self.hold_mph = hold_mph  # the speed that was held last, or is offered
        self.rates = RateMeter()
        self.is_ended = False  # the person has ended the drive
        self.why = "stopped at the terminal"  # reason for the drive's end
        self.began_s: float | None = None  # of the first telemetry, by the simulator's clock if it has one

    def take_control(self) -> Control:
        """The newest controls, which are in force from now on."""
        self.control = self.wheel.control()
        self.hold_mph = self.control.hold_mph or self.hold_mph
        return self.control

    def attend(self) -> list[str]:
        """Carry out the page's requests. Returns their events for the log."""
        return [text for request in self.wheel.requests() for text in self.handle(request)]

    def handle(self, request: Request) -> list[str]:
        """Carry out one request; drives add their own."""
        if request.kind == "end":
            self.is_ended, self.why = True, "ended on the page"
        return self.recording.handle(request)

    def state_of(self, telemetry: Telemetry, *, recorded_s: float | None = None, **sent: Any) -> FrameState:
        """The state of a drive that telemetry reports. `recorded_s`: by default since its beginning. `sent`: the
        members of `FrameState` that telemetry does not have."""
        now_s, world = time.monotonic(), telemetry.world
        simulated_s = None if world is None else world.time_s
        time_s = now_s if simulated_s is None else simulated_s
        if self.began_s is None or time_s < self.began_s:
            self.began_s = time_s
        self.rates.add(now_s, simulated_s)
        return FrameState(
            time_s=time_s - self.began_s,
            control=self.control,
            speed_mph=telemetry.speed_mph,
            recorded_s=time_s - self.began_s if recorded_s is None else recorded_s,
            is_recording=self.recording.is_on,
            pace=self.rates.pace,
            picture_hz=self.rates.frames_per_s,
            place=None if world is None else world.pose,
            laps=None if world is None else world.laps,
            put_back=0 if world is None else world.interventions or 0,
            **sent,
        )
