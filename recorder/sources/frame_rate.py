"""The frame rate of a recording whose frames have no times of their own, as the user gives it."""

from __future__ import annotations

from typing import Final

from recorder.errors import RecordingError

MIN_HZ: Final = 1.0  # farther apart, each row would be a drive of its own
MAX_HZ: Final = 1000.0


def check_rate(rate_hz: float | None) -> None:
    """Raise RecordingError for a rate that no camera has."""
    if rate_hz is not None and not MIN_HZ <= rate_hz <= MAX_HZ:
        raise RecordingError(f"--rate {rate_hz:g}: give frames a second, {MIN_HZ:g} to {MAX_HZ:,.0f}")


def describe_clock(rate_hz: float) -> str:
    """Describe such times in a log's metadata."""
    return f"{rate_hz:g} Hz, as --rate said, because the recording has no times"
