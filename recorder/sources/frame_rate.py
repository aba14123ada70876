"""The frame rate of a recording whose frames have no times of their own, as the user gives it."""

from __future__ import annotations

from typing import Final

from recorder.errors import RecordingError

LEAST_HZ: Final = 1.0  # farther apart, each row would be a drive of its own
MOST_HZ: Final = 1000.0


def check_rate(rate_hz: float | None) -> None:
    """Raise RecordingError for a rate that no camera has."""
    if rate_hz is not None and not LEAST_HZ <= rate_hz <= MOST_HZ:
        raise RecordingError(f"--rate {rate_hz:g}: give frames a second, {LEAST_HZ:g} to {MOST_HZ:,.0f}")


def describe_clock(rate_hz: float) -> str:
    """Describe such times in a log's metadata."""
    return f"{rate_hz:g} Hz, as --rate said, because the recording does not tell its times"
