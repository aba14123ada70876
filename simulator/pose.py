"""The pose of a car: its position and its angles."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Pose:
    """The point on the ground under the middle of the rear axle, and three angles."""

    x_m: float  # east
    y_m: float  # north
    z_m: float  # up
    heading_rad: float  # counter-clockwise from +x
    pitch_rad: float = 0.0  # nose up is positive
    roll_rad: float = 0.0  # right side down is positive
