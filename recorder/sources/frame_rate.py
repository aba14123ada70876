"""Rates from the user: of a recording without times, and of a person's rows."""

from __future__ import annotations

import math
from typing import Final

from recorder.errors import RecordingError
from simulator.driving.vehicle import STEP_S

MIN_HZ: Final = 1.0  # at lower rates, each row would be a drive of its own
MAX_HZ: Final = 1000.0
_TINY: Final = 1e-6


def check_rate(rate_hz: float | None) -> None:
    """Raise RecordingError for a rate that no camera has."""
    if rate_hz is not None and not MIN_HZ <= rate_hz <= MAX_HZ:
        raise RecordingError(f"--rate {rate_hz:g}: give frames a second, {MIN_HZ:g} to {MAX_HZ:,.0f}")


def describe_clock(rate_hz: float) -> str:
    """The description of such times in a log's metadata."""
    return f"{rate_hz:g} Hz, as --rate said, because the recording has no times"


def check_row_rate(rate_hz: float) -> None:
    """Raise RecordingError for a person's rate unless rows are a whole number of half steps apart, at least one
    step."""
    half_steps = 2 / (rate_hz * STEP_S) if rate_hz > 0 else 0.0
    if half_steps < 2 - _TINY or abs(half_steps - round(half_steps)) > _TINY:
        raise RecordingError(f"--rate {rate_hz:g}: expected a divisor of 100, at most 50, such as 10 or 20")


def is_row_step(step: int, rate_hz: float) -> bool:
    """True if this step has a row. At 20 rows a second, rows are alternately 2 and 3 steps apart."""
    rows_a_step = rate_hz * STEP_S
    row = math.ceil(step * rows_a_step - _TINY)
    return math.floor(row / rows_a_step + _TINY) == step
