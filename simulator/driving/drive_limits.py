"""The most that a drive of the built-in simulator may be asked for: more is a slip of the finger."""

MAX_SPEED_MPH = 100
"""Of a set speed; the car reaches 30."""
MAX_LAPS = 1000
"""A lap that is recorded takes some 70 MB."""
