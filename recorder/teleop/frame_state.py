"""What a page at the wheel is shown with a picture: who drives, what is sent, what is recorded."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from recorder.rows.devices import Device
from recorder.teleop.seat import Control
from simulator.driving.vehicle import CarState
from simulator.pose import Pose

Drives = Literal["pilot", "human", "expert", "brake", "nobody"]


@dataclass(frozen=True, kw_only=True)
class FrameState:
    """The state of a drive at a picture. None, or NaN, is unknown."""

    time_s: float
    control: Control  # in force
    drives: Drives
    device: Device | None
    steering: float  # -1 (left) .. 1 (right), as sent
    predicted: float | None = None  # the network's steering
    throttle: float  # -1 .. 1, as sent; below 0 brakes
    speed_mph: float | None
    rows: int
    recorded_s: float
    is_recording: bool = True
    pace: float | None  # simulated seconds per second
    picture_hz: float | None = None  # shown lately
    place: Pose | CarState | None
    laps: float | None
    takeovers: int = 0
    put_back: int = 0

    def as_message(self) -> dict[str, object]:
        """The members of a page's message, each a JSON value."""
        message = {name: _plain(value) for name, value in vars(self).items() if name != "place"}
        message |= {"control": self.control.number, "control_time_ms": self.control.time_ms}
        place = self.place
        x, y, heading_rad = (None,) * 3 if place is None else (place.x_m, place.y_m, place.heading_rad)
        return message | {"x": x, "y": y, "heading_rad": heading_rad}


def drives_alone(control: Control, *, is_rolling: bool) -> Drives:
    """Who drives where no network does: without its person, a car that rolls is braked."""
    if not control.is_absent:
        return "human"
    return "brake" if is_rolling else "nobody"


def _plain(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value
