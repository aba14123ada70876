"""The car that is recorded and driven: its cameras, how far its front wheels turn, the unit of its speed."""

from __future__ import annotations

from typing import Final, Literal, get_args

Camera = Literal["center", "left", "right"]
"""A new camera is one name more here: its topic, its columns and its view in the viewer follow from it."""
CAMERAS: Final[tuple[Camera, ...]] = get_args(Camera)

MAX_STEERING_DEG: Final = 25.0  # steering 1.0, as in the simulator (its CarController's maximum steer angle)

MPS_PER_MPH: Final = 0.44704  # by the definition of the mile

SPEED_RANGE_MPH: Final = (-30.0, 300.0)
"""No car reverses faster, and no simulator's that anybody drives goes faster; the real simulator's reaches 30."""
