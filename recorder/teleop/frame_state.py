"""The messages for a page at the wheel: first the drive and its road, then the state of each frame
with its rates."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final, Literal

import numpy as np

from recorder.teleop.seat import Control
from recorder.topics import Device
from simulator.driving.vehicle import CarState
from simulator.pose import Pose
from simulator.roads.track import Track, load_track

_EDGE_EVERY_M: Final = 4.0
Drives = Literal["pilot", "human", "expert", "brake", "nobody"]


def hello(
    kind: Literal["record", "listen", "drive"],
    log: Path,
    *,
    track: Track | None = None,
    run: str | None = None,
    rate_hz: float | None = None,
    picture_hz: float | None = None,
    hold_mph: float = 10.0,
) -> dict[str, object]:
    """The message "hello" of a `Wheel`. `rate_hz`: recorded rows a second; None if the simulator decides."""
    return {
        "kind": kind,
        "session": log.stem,
        "run": run,
        "track": None if track is None else track.name,
        "road": None if track is None else road_edges(track),
        "rate_hz": rate_hz,
        "picture_hz": picture_hz,
        "hold_mph": hold_mph,
    }


def road_edges(track: Track) -> dict[str, object]:
    """The road's edges as closed lines of points in metres, x east and y north."""
    line = track.line
    stride = max(1, round(_EDGE_EVERY_M / line.step_m))
    middle, heading = line.points_m[::stride, :2], line.heading_rad[::stride]
    to_left = np.stack([-np.sin(heading), np.cos(heading)], axis=1) * track.half_width_m[::stride, None]
    edges = {"left": middle + to_left, "right": middle - to_left}
    return {name: points.round(2).tolist() for name, points in edges.items()} | {"closed": True}


@lru_cache(8)
def road_named(name: str, fingerprint: str = "") -> dict[str, object] | None:
    """The edges of the built-in road of that name (`road_edges`); None for another name, or if `fingerprint` is
    known and differs: another version had that road."""
    try:
        track = load_track(name)
    except ValueError:
        return None
    return road_edges(track) if fingerprint in ("", track.fingerprint()) else None


@dataclass(frozen=True, kw_only=True)
class FrameState:
    """The state of a drive at a frame. None and NaN are unknown."""

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
    picture_hz: float | None = None  # pictures shown a second
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
    """The driver if no network drives. If the person is absent, a rolling car is braked."""
    if not control.is_absent:
        return "human"
    return "brake" if is_rolling else "nobody"


def _plain(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


OVER_S: Final = 2.0


class RateMeter:
    """Measures frames a second and the pace of a simulator's clock."""

    def __init__(self) -> None:
        self._frames: deque[tuple[float, float | None]] = deque()  # this computer's time, the simulator's

    def add(self, now_s: float, simulated_s: float | None = None) -> None:
        """Note a frame at `now_s` of a monotonic clock, and at `simulated_s`, if the simulator sends its time."""
        before_s = self._frames[-1][1] if self._frames else None
        if before_s is not None and simulated_s is not None and simulated_s < before_s:  # another drive
            self._frames.clear()
        self._frames.append((now_s, simulated_s))
        while self._frames[0][0] < now_s - OVER_S:
            self._frames.popleft()

    @property
    def frames_per_s(self) -> float:
        passed_s = self._frames[-1][0] - self._frames[0][0] if self._frames else 0.0
        return (len(self._frames) - 1) / passed_s if passed_s else 0.0

    @property
    def pace(self) -> float | None:
        """Simulated seconds per second; 1 is real time. None if unknown."""
        if not self._frames:
            return None
        (first_s, first_simulated_s), (last_s, last_simulated_s) = self._frames[0], self._frames[-1]
        if first_simulated_s is None or last_simulated_s is None or last_s <= first_s:
            return None
        return (last_simulated_s - first_simulated_s) / (last_s - first_s) or None  # a standing clock has no pace
