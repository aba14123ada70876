"""Steering habits in words and numbers."""

from __future__ import annotations

from typing import Final

from common.errors import counted
from common.steering_unit import DEGREES, SteeringUnit
from recorder.rows.steering_habits import Kind, SteeringHabits, SteeringLag

STEERING_HEADINGS: Final = ("steered", "zeros", "presses", "Hz", "ceiling", "lag, s")
_IN_WORDS: Final[dict[Kind, str]] = {
    "none": "never",
    "constant": "constant",
    "too short": "too short",
    "other scale": "scale?",
    "steps": "in steps",
    "smooth": "smooth",
}


def steering_cells(habits: SteeringHabits, lag: SteeringLag | None) -> list[str]:
    """The cells under `STEERING_HEADINGS`; "-" if unknown."""
    return [
        _how(habits),
        _formatted(habits.zeros, "{:.0%}"),
        f"{habits.presses:,}" + (f" x {habits.press_s:.1f} s" if habits.press_s else ""),
        _formatted(habits.rate_hz, "{:.1f}"),
        _formatted(habits.ceiling[1], "{:.2f}"),
        _lag_words(lag) if lag else "-",
    ]


def steering_line(habits: SteeringHabits, lag: SteeringLag | None, unit: SteeringUnit = DEGREES) -> str:
    """Habits and lag in one line."""
    spread, largest = (
        None if angle_deg is None else unit.of(angle_deg) for angle_deg in (habits.spread_deg, habits.largest_deg)
    )
    parts = [
        f"steered: {_how(habits)}",
        f"{_formatted(habits.zeros, '{:.0%}')} zeros, {_formatted(habits.left, '{:.0%}')} left,"
        f" {_formatted(habits.right, '{:.0%}')} right",
        counted(habits.presses, "press", "presses") + (f" of {habits.press_s:.2f} s" if habits.press_s else ""),
        f"{counted(habits.values, 'value')}",
        f"{_formatted(habits.rate_hz, '{:.1f}')} rows/s",
        f"spread {_formatted(spread, '{:.2f}')} {unit.short}, up to {_formatted(largest, '{:.1f}')}",
        f"ceiling {' / '.join(_formatted(ceiling, '{:.2f}') for ceiling in habits.ceiling)}",
    ]
    if lag is not None:
        parts.append(lag_in_words(lag))
    return "; ".join(parts)


def lag_in_words(lag: SteeringLag) -> str:
    return f"lag {_lag_words(lag)} s (correlation {lag.correlation:.2f})"


def _lag_words(lag: SteeringLag) -> str:
    margin = "" if lag.margin_s is None else f" \N{PLUS-MINUS SIGN}{lag.margin_s:.2f}"
    return f"{lag.lag_s:+.2f}{margin}"


def _how(habits: SteeringHabits) -> str:
    if habits.device:
        return habits.device
    return "keys" if habits.keys and habits.kind == "steps" else _IN_WORDS[habits.kind]


def _formatted(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
