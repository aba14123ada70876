"""The drivers of the built-in simulator by name, and the limits of a drive."""

from typing import Literal

DriverName = Literal["expert", "keyboard", "mouse"]

MAX_SPEED_MPH = 100  # maximum set speed; the car reaches 30 mph
MAX_LAPS = 1000  # a recorded lap needs about 70 MB
