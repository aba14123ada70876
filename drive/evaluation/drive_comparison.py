"""Two runs compared by driving the same tracks at the same speeds, stretch of road by stretch of road.

bc-eval compare A B --tracks lake mountain random:1
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drive.control.drive_clock import PUT_BACK
from drive.evaluation.closed_loop import DriveResult
from model.evaluation.differences import CONFIDENCE, Difference, Floats, Measure, Verdict, compare_sums, overall
from recorder import Log
from recorder.topics import EVENTS, POSE
from simulator.driving.course import INTERVENTION_COST_S
from simulator.driving.vehicle import AXLE_TO_CENTRE_M
from simulator.roads.track import Track, load_track

TOLERANCE: Final = 0.02  # two good networks differ by a few centimetres everywhere
STRETCH_M: Final = 50.0  # 11 s at 10 mph: an error in one stretch seldom continues in the next

MEASURES: Final = (
    Measure("interventions", "interventions"),
    Measure("autonomy_percent", "autonomy, %", is_error=False, scale=100.0),
    Measure("mean_offset", "mean offset", scale=1.0),
)
"""Offsets are shares of the road's half width, as in a drive's report."""

_SUMS: Final = 3  # seconds, interventions, offset x seconds


@dataclass(frozen=True)
class DriveComparison:
    """The drives of A and of B: the same tracks and speeds, in the same order."""

    run_a: str
    run_b: str
    a: Sequence[DriveResult]
    b: Sequence[DriveResult]
    tolerance: float = TOLERANCE

    @cached_property
    def _sums(self) -> tuple[Floats, Floats]:
        """The sums of A and of B, (stretches, K) each, over the stretches of road that either has driven."""
        a, b = (_sums_of_tracks(drives) for drives in (self.a, self.b))
        # rounding puts a car at the start a hair before the line: its first messages, 1 ns apart, drive no stretch
        is_driven = np.maximum(a[:, 0], b[:, 0]) > 1e-3
        return a[is_driven], b[is_driven]

    @property
    def stretches(self) -> int:
        return len(self._sums[0])

    @cached_property
    def differences(self) -> tuple[Difference, ...]:
        return compare_sums(*self._sums, MEASURES, _measures, self.tolerance)

    @property
    def gave_up(self) -> tuple[str, ...]:
        """The tracks that A finished and B did not."""
        pairs = zip(self.a, self.b, strict=True)
        return tuple(b.simulator.track for a, b in pairs if b.report["gave_up"] and not a.report["gave_up"])

    @property
    def verdict(self) -> Verdict:
        return "worse" if self.gave_up else overall(self.differences)

    def as_dict(self) -> dict[str, Any]:
        pairs = zip(self.a, self.b, strict=True)
        return {
            "a": self.run_a,
            "b": self.run_b,
            "drives": [{"a": a.as_dict(), "b": b.as_dict()} for a, b in pairs],
            "stretches": self.stretches,
            "confidence": CONFIDENCE,
            "tolerance": self.tolerance,
            "measures": {difference.measure.name: difference.as_dict() for difference in self.differences},
            "gave_up": list(self.gave_up),
            "verdict": self.verdict,
        }


def _sums_of_tracks(drives: Sequence[DriveResult]) -> Floats:
    """The sums of every stretch of every track, (stretches, 3). Drives of a track at several speeds are added up,
    like laps: a stretch that is hard at one speed is hard at others, so they are not independent observations."""
    tracks: dict[str, Floats] = {}
    for drive in drives:
        sums = _sums_of_stretches(drive)
        tracks[drive.simulator.track] = sums + tracks.get(drive.simulator.track, 0.0)
    return np.concatenate(list(tracks.values()))


def _sums_of_stretches(drive: DriveResult) -> Floats:
    """The sums over each stretch of the track, (stretches, 3): seconds, interventions, and the distance from the
    centre line (a share of the half width) times seconds. Laps are added up."""
    track = load_track(drive.simulator.track)
    time_ns, arc_m, offset = _course(drive.log, track)
    with Log(drive.log) as log:
        put_back_ns = [message.log_time_ns for message, event in log.decoded(EVENTS) if event.message == PUT_BACK]
    put_back = np.searchsorted(time_ns, np.array(put_back_ns, np.int64), side="right") - 1
    seconds = np.diff(time_ns, prepend=time_ns[:1]) / 1e9
    stretches = max(1, round(track.line.length_m / STRETCH_M))
    stretch = np.minimum((arc_m / track.line.length_m * stretches).astype(np.int64), stretches - 1)
    sums = np.zeros((stretches, _SUMS))
    np.add.at(sums[:, 0], stretch, seconds)
    np.add.at(sums[:, 1], stretch[put_back], 1)
    np.add.at(sums[:, 2], stretch, offset * seconds)
    return sums


def _course(path: Path, track: Track) -> tuple[NDArray[np.int64], Floats, Floats]:
    """For each pose of the log: log time in ns, arc length along the road in m, and the distance from the centre
    line as a share of the road's half width."""
    with Log(path) as log:
        poses = [(message.log_time_ns, pose.pose) for message, pose in log.decoded(POSE)]
    near_m = 0.0  # every drive begins at arc length 0
    arcs_m, offsets = [], []
    for _, pose in poses:
        q = pose.orientation
        # the car's x axis, rotated by the quaternion: from the rear axle to the middle of the car
        forward = 1 - 2 * (q.y**2 + q.z**2), 2 * (q.x * q.y + q.w * q.z)
        x_m, y_m = (
            at + AXLE_TO_CENTRE_M * along
            for at, along in zip((pose.position.x, pose.position.y), forward, strict=True)
        )
        near_m, offset_m = track.line.project(x_m, y_m, near_m)
        half_width_m = track.half_width_m[round(near_m / track.line.step_m) % len(track.half_width_m)]
        arcs_m.append(near_m)
        offsets.append(abs(offset_m) / float(half_width_m))
    return np.array([time_ns for time_ns, _ in poses], np.int64), np.array(arcs_m), np.array(offsets)


def _measures(sums: Floats) -> Floats:
    """`MEASURES` from the sums of stretches, (..., 3) to (..., 3)."""
    seconds, interventions, offset_seconds = np.moveaxis(sums, -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        autonomy = 100 * np.maximum(0.0, 1 - INTERVENTION_COST_S * interventions / seconds)
        return np.stack([interventions, autonomy, offset_seconds / seconds], axis=-1)
