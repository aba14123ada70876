"""A person at the wheel of a drive: send each frame to the page, and carry out the page's requests."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Final

from common.errors import counted
from common.interrupts import StopEvent
from drive.config import DriveConfig
from drive.control.driver import Decision
from drive.control.takeover import PersonTakeover
from recorder.log.tags import Tag
from recorder.sources.eye_pictures import EyeMoment, EyePictures
from recorder.teleop.frame_state import FrameState
from recorder.teleop.rate_meter import RateMeter
from recorder.teleop.recording import LastRows
from recorder.teleop.wheel import Wheel

MAX_LISTED: Final = 1000  # takeovers that the page lists at the end
PUT_BACK: Final = "the person puts the car back on its line"
_POLL_S: Final = 0.1  # while it waits for the page


class AtWheel:
    """The page of a drive. Its methods return at once."""

    def __init__(self, wheel: Wheel, config: DriveConfig, eye: EyePictures | None = None) -> None:
        """`eye` renders the page's pictures, if the simulator is the built-in one."""
        self.person = PersonTakeover(wheel, config.set_speed_mph, config.car)
        self.is_end_asked = False
        """True after the page has requested the end of the drive."""
        self._eye = eye
        self._is_put_back_asked = False
        self._wheel = wheel
        self._rates = RateMeter()
        self._takeovers: list[dict[str, float]] = []
        self._counted = 0
        self._was_human = False
        self._began_s: float | None = None
        self._driven = ""  # laps and interventions, in words
        self.last_rows = LastRows(wheel)

    def attend(self) -> list[str]:
        """Carry out the page's requests. Returns their events."""
        events: list[str] = []
        for request in self._wheel.requests():
            if request.kind == "hand_back":
                events += (handed_back := self.person.hand_back())
                for text in handed_back:
                    self._wheel.event(text)
            elif request.kind == "end":
                self.is_end_asked = True
            elif request.kind == "bad":
                events += self.last_rows.exclude(request.seconds)
            elif request.kind == "put_back" and self._eye is not None:
                self._is_put_back_asked = True
                events.append(PUT_BACK)
                self._wheel.event(PUT_BACK)
            elif request.kind == "put_back":
                events.append("the page cannot put the car back: only its simulator can")
        return events

    def puts_back(self) -> bool:
        """True if the next command must put the car back: once for each request of the page."""
        is_asked, self._is_put_back_asked = self._is_put_back_asked, False
        return is_asked

    def wait_for_page(self, stopped: StopEvent) -> bool:
        """Wait until the person's page is open. Returns False if `stopped` is set first."""
        while not self._wheel.pages:
            if stopped.wait(_POLL_S):
                return False
        return True

    def show(self, decision: Decision, row: int) -> None:
        """Show an answered telemetry message, row `row` of the log."""
        if (telemetry := decision.telemetry) is None:
            return
        now_s, world = time.monotonic(), telemetry.world
        simulated_s = None if world is None else world.time_s
        time_s = now_s if simulated_s is None else simulated_s
        if self._began_s is None or time_s < self._began_s:
            self._began_s = time_s
        self._rates.add(now_s, simulated_s)
        self.last_rows.add(round(time_s * 1e9), row)
        if world is not None and world.laps is not None:
            put_back = counted(world.interventions or 0, "time")
            self._driven = f" after {world.laps:.2f} laps; the car was put back {put_back}"
        is_human = decision.driver == "human"
        if is_human and not self._was_human:
            self._counted += 1
            if len(self._takeovers) < MAX_LISTED:
                self._takeovers.append({"row": row, "time_s": round(time_s - self._began_s, 2)})
        self._was_human = is_human
        pose = None if world is None else world.pose
        state = FrameState(
            time_s=time_s - self._began_s,
            control=self.person.control,
            drives=decision.driver,
            device=decision.device,
            steering=decision.steering,
            predicted=decision.predicted_steering,
            throttle=decision.throttle,
            speed_mph=telemetry.speed_mph,
            rows=row + 1,
            recorded_s=time_s - self._began_s,
            pace=self._rates.pace,
            picture_hz=self._rates.frames_per_s,
            place=pose,
            laps=None if world is None else world.laps,
            takeovers=self._counted,
            put_back=0 if world is None or world.interventions is None else world.interventions,
        )
        if self._eye is None or pose is None:
            self._wheel.show(state.as_message(), telemetry.picture)
        else:
            self._eye.offer(EyeMoment(row, pose, state, telemetry.picture))

    def note_silence(self, silent_s: float, *, is_connected: bool) -> None:
        """Let the page show that the simulator is silent, or has gone."""
        self._wheel.note_silence(silent_s, is_connected=is_connected)

    def leave(self) -> list[Tag]:
        """Leave a session: the next one has its own car, rows and takeovers. Returns the tags of its rows."""
        self.person.hand_back()
        self._wheel.wait_for_touch()
        tags, self.last_rows = self.last_rows.tags, LastRows(self._wheel)
        self._takeovers, self._was_human, self._began_s = [], False, None
        return tags

    def event(self, text: str, *, is_problem: bool) -> None:
        self._wheel.event(text, is_problem=is_problem)

    def end(self, log: Path, rows: int) -> None:
        """Tell the page that the drive has ended and its log is finished."""
        why = f"the drive has ended{self._driven}"
        self._wheel.end({"log": str(log), "rows": rows, "takeovers": self._takeovers, "why": why})
