"""The car: its cameras, the steering angle of its front wheels, the unit and range of its speed."""

from __future__ import annotations

from typing import Final, Literal, get_args

Camera = Literal["center", "left", "right"]
"""To add a camera, add its name: its topic, its columns and its view in the viewer follow from the name."""
CAMERAS: Final[tuple[Camera, ...]] = get_args(Camera)

MAX_STEERING_DEG: Final = 25.0  # at steering 1.0; the maximum steer angle of the Udacity simulator's CarController
BUILT_IN_WHEELBASE_M: Final = 2.6  # of the built-in simulator's car, which is of middle size

MPS_PER_MPH: Final = 0.44704  # by the definition of the mile

SPEED_RANGE_MPH: Final = (-30.0, 300.0)
"""No car of a simulator is faster, forwards or in reverse. The car of the Udacity simulator reaches 30 mph."""
