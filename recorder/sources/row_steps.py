"""Which steps of the built-in simulator a person's rows fall on, by their rate."""

from __future__ import annotations

import math
from typing import Final

from recorder.errors import RecordingError
from simulator.driving.vehicle import STEP_S

_TINY: Final = 1e-6


def check_row_rate(rate_hz: float) -> None:
    """Raise RecordingError for a rate whose rows are not a whole number of half steps apart, one step at least."""
    half_steps = 2 / (rate_hz * STEP_S) if rate_hz > 0 else 0.0
    if half_steps < 2 - _TINY or abs(half_steps - round(half_steps)) > _TINY:
        raise RecordingError(f"--rate {rate_hz:g}: at most 50 that divides 100 was expected (as 5, 10, 20, 25)")


def is_row_step(step: int, rate_hz: float) -> bool:
    """True if a row falls on that step. At 20 rows a second they are 2 and 3 steps apart by turns."""
    rows_a_step = rate_hz * STEP_S
    row = math.ceil(step * rows_a_step - _TINY)
    return math.floor(row / rows_a_step + _TINY) == step
