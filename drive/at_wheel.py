"""A person at the wheel of a drive: send each frame to the page, and carry out the page's requests."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from common.errors import counted
from common.interrupts import StopEvent
from drive.config import DriveConfig
from drive.control.driver import Decision
from drive.control.takeover import PersonTakeover
from recorder.log.tags import Tag
from recorder.sources.eye_pictures import EyeMoment, EyePictures
from recorder.teleop.cockpit import Cockpit, Recording
from recorder.teleop.wheel import Request, Wheel

PUT_BACK: Final = "the person puts the car back on its line"
_POLL_S: Final = 0.1  # while it waits for the page


class AtWheel(Cockpit):
    """The page of a drive. Its methods return at once."""

    def __init__(self, wheel: Wheel, config: DriveConfig, eye: EyePictures | None = None) -> None:
        """`eye` renders the page's pictures, if the simulator is the built-in one."""
        super().__init__(wheel, config.set_speed_mph, has_network=True)
        self.person = PersonTakeover(self)
        self._eye = eye
        self._is_put_back_asked = False
        self._takeovers: list[dict[str, float]] = []
        self._counted = 0
        self._was_human = False
        self._driven = ""  # laps and interventions, in words

    def handle(self, request: Request) -> list[str]:
        if request.kind == "hand_back":
            for text in (events := self.person.hand_back()):
                self.wheel.event(text)
            return events
        if request.kind == "put_back" and self._eye is None:
            return ["the page cannot put the car back: only its simulator can"]
        if request.kind == "put_back":
            self._is_put_back_asked = True
            self.wheel.event(PUT_BACK)
            return [PUT_BACK]
        return [] if request.kind in ("record", "pause") else super().handle(request)

    def puts_back(self) -> bool:
        """True if the next command must put the car back: once for each request of the page."""
        is_asked, self._is_put_back_asked = self._is_put_back_asked, False
        return is_asked

    def wait_for_page(self, stopped: StopEvent) -> bool:
        """Wait until the person's page is open. Returns False if `stopped` is set first."""
        while not self.wheel.pages:
            if stopped.wait(_POLL_S):
                return False
        return True

    def show(self, decision: Decision, row: int) -> None:
        if (telemetry := decision.telemetry) is None:
            return
        world = telemetry.world
        is_human = decision.driver == "human"
        if is_human and not self._was_human:
            self._counted += 1
        state = self.state_of(
            telemetry,
            drives=decision.driver,
            device=decision.device,
            steering=decision.steering,
            predicted=decision.predicted_steering,
            throttle=decision.throttle,
            rows=row + 1,
            takeovers=self._counted,
        )
        self.recording.add(round(state.time_s * 1e9), row)
        if is_human and not self._was_human:
            self._takeovers.append({"row": row, "time_s": round(state.time_s, 2)})
        self._was_human = is_human
        if world is not None and world.laps is not None:
            put_back = counted(world.interventions or 0, "time")
            self._driven = f" after {world.laps:.2f} laps; the car was put back {put_back}"
        pose = None if world is None else world.pose
        if self._eye is None or pose is None:
            self.wheel.show(state.as_message(), telemetry.picture)
        else:
            self._eye.offer(EyeMoment(row, pose, state, telemetry.picture))

    def leave(self) -> list[Tag]:
        """Leave a session: the next one has its own car, rows and takeovers. Returns the tags of its rows."""
        self.person.hand_back()
        self.wheel.wait_for_touch()
        tags, self.recording = self.recording.tags, Recording(self.wheel, is_on=True)
        self._takeovers, self._was_human, self.began_s = [], False, None
        return tags

    def end(self, log: Path, rows: int) -> None:
        why = f"the drive has ended{self._driven}"
        self.wheel.end({"log": str(log), "rows": rows, "takeovers": self._takeovers, "why": why})
