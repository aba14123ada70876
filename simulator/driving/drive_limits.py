"""What a drive of the built-in simulator may be asked for: its drivers, and how much at most."""

from typing import Literal

DriverName = Literal["expert", "keyboard", "mouse"]

MAX_SPEED_MPH = 100
"""Of a set speed; the car reaches 30."""
MAX_LAPS = 1000
"""A lap that is recorded takes some 70 MB."""
