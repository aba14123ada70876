"""Steering habits of a session, from its rows alone: presses, steps or smooth steering, and how much can be
learnt.

A keyboard has three positions, and a press lasts a fraction of a second. The correlation between a row's steering
and that of the rows around it limits how well any network can predict it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from common.car import MAX_STEERING_DEG
from common.errors import counted
from common.steering_unit import DEGREES, SteeringUnit
from common.stretches import runs
from recorder.rows.row_quality import States, Values, drive_numbers, driven_s, elapsed_s, usual_step
from recorder.topics import RowDevice

CEILING_S: Final = (0.25, 0.5, 1.0)
"""The times around a row, half before and half after, in which the other rows are its neighbours."""
ENOUGH_S: Final = 60.0
"""Of driving. A shorter session has too few presses and bends to recognise a habit."""
NARROW: Final = 0.05
"""Steering within +-1.25 degrees for a minute has another scale: no road is so straight."""
MAX_OUT_OF_RANGE: Final = 0.1
"""Steering outside -1..1 in a larger share of rows has another scale, such as degrees."""
STEPS_ZEROS: Final = 0.3
STEPS_CEILING: Final = 0.9
"""Recordings of people at keyboards have an exact 0 in 45 to 80 % of rows, and ceilings of 0.37 to 0.95.
Continuous steering (a wheel, a machine) has neither."""
KEYS_VALUES: Final = 16  # keys without a ramp give -1, 0 and 1
KEYS_SHARE: Final = 0.4
KEYS_NEAR: Final = 0.1
"""Keys turn the wheel at one rate (Unity: 3 times full lock a second): this share of changes is so near to it."""

_ROUNDING_S: Final = 1e-6  # evenly spaced rows lie exactly on the limit
_NO_SPREAD: Final = 1e-9

Kind = Literal["none", "constant", "too short", "other scale", "steps", "smooth"]


@dataclass(frozen=True)
class SteeringHabits:
    """Measures of how a session was steered. Rows with steering out of range count only in `out_of_range`. None:
    too few rows."""

    kind: Kind
    rows: int
    out_of_range: float  # share of all rows
    driven_s: float
    rate_hz: float | None  # usual rows a second
    zeros: float | None  # share of the rows with steering exactly 0
    left: float | None  # share of the rows steered to the left
    right: float | None
    values: int  # different values
    presses: int  # stretches of rows with steering other than 0
    press_s: float | None  # their median length
    keys: bool  # steering turns at one rate, or has only a few positions
    spread_deg: float | None  # standard deviation
    largest_deg: float | None  # to either side
    ceiling: tuple[float | None, float | None, float | None]  # for each of CEILING_S
    crashes: float | None  # share of the rows in crashes
    device: RowDevice = ""  # the recorded device of most rows; empty if the log names none


@dataclass(frozen=True)
class SteeringLag:
    """The lag of steering behind the turning that pictures show, as `recorder.log.known_lag` measures it."""

    lag_s: float  # from the turning to the steering; negative: the steering comes first
    correlation: float  # of both at that lag; negative: the pictures turn the other way
    pictures: int  # decoded
    margin_s: float | None = None  # uncertainty of `lag_s`; None if an earlier version measured it

    @property
    def is_mirrored(self) -> bool:
        """True if the pictures turn the other way: left and right may be swapped."""
        return self.correlation < 0


@dataclass(frozen=True)
class LagFinding:
    lag: SteeringLag | None  # None: the pictures do not show it


def steering_habits(
    states: States, max_steering_deg: float = MAX_STEERING_DEG, device: RowDevice = ""
) -> SteeringHabits:
    """Measure the habits in the rows of a log. `max_steering_deg`: the wheels' angle at steering 1. `device`: that
    of most rows. Takes any numbers."""
    in_range = np.abs(states.steering) <= 1  # False for NaN too
    steering, time_ns = states.steering[in_range], states.time_ns[in_range]
    rows = len(steering)
    drive = drive_numbers(time_ns)
    same = np.diff(drive) == 0
    steps_s = (np.diff(time_ns)[same]) / 1e9
    steps_s = steps_s[steps_s > 0]
    step_s = usual_step(steps_s) if len(steps_s) else None
    presses = _presses(steering, drive)
    out_of_range = 1 - rows / len(in_range) if len(in_range) else 0.0
    is_beyond = bool((np.abs(states.steering) > 1).any())  # False for NaN
    ceiling = _ceilings(steering, elapsed_s(time_ns))
    return SteeringHabits(
        kind=_kind(steering, out_of_range, is_beyond, driven_s(states.time_ns), ceiling[1]),
        rows=rows,
        out_of_range=out_of_range,
        driven_s=driven_s(states.time_ns),
        rate_hz=1 / step_s if step_s else None,
        zeros=_share(steering == 0),
        left=_share(steering < 0),
        right=_share(steering > 0),
        values=len(np.unique(steering)),
        presses=len(presses),
        press_s=float(np.median(presses)) * step_s if len(presses) and step_s else None,
        keys=_is_of_keys(steering, time_ns, same),
        spread_deg=float(steering.std()) * max_steering_deg if rows else None,
        largest_deg=float(np.abs(steering).max()) * max_steering_deg if rows else None,
        ceiling=ceiling,
        crashes=_share(states.flags["crash"]),
        device=device,
    )


def _kind(steering: Values, out_of_range: float, is_beyond: bool, seconds: float, ceiling: float | None) -> Kind:
    if out_of_range > MAX_OUT_OF_RANGE:
        return "other scale"
    if not steering.any():  # also without rows
        return "other scale" if is_beyond else "none"
    if (steering == steering[0]).all():
        return "constant"
    if seconds < ENOUGH_S:
        return "too short"
    if np.abs(steering).max() < NARROW:
        return "other scale"
    is_in_steps = (steering == 0).mean() >= STEPS_ZEROS or (ceiling is not None and ceiling < STEPS_CEILING)
    return "steps" if is_in_steps else "smooth"


def neighbours_mean(steering: Values, time_s: Values, reach_s: float) -> Values:
    """For each row (N,), the mean steering of the other rows within `reach_s`; NaN if there are none. `time_s`:
    from `elapsed_s`, ascending."""
    begin = np.searchsorted(time_s, time_s - reach_s - _ROUNDING_S, side="left")
    end = np.searchsorted(time_s, time_s + reach_s + _ROUNDING_S, side="right")
    total = np.concatenate([[0.0], np.cumsum(steering)])
    others = end - begin - 1
    mean = (total[end] - total[begin] - steering) / np.maximum(others, 1)
    return np.where(others > 0, mean, np.nan)


def _ceilings(steering: Values, time_s: Values) -> tuple[float | None, float | None, float | None]:
    ceilings = [_correlation(steering, neighbours_mean(steering, time_s, width_s / 2)) for width_s in CEILING_S]
    return ceilings[0], ceilings[1], ceilings[2]


def _correlation(a: Values, b: Values) -> float | None:
    """The correlation of the rows where both are finite; None if one of them does not vary."""
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both], b[both]
    if len(a) < 3 or a.std() < _NO_SPREAD or b.std() < _NO_SPREAD:
        return None
    return float(np.corrcoef(a, b)[0, 1])


def _presses(steering: Values, drive: NDArray[np.int64]) -> NDArray[np.int64]:
    """The number of rows in each stretch of steering other than 0."""
    pressed = steering != 0
    first, last = runs((np.diff(pressed) != 0) | (np.diff(drive) != 0), len(pressed))
    return (last - first + 1)[np.flatnonzero(pressed[first])]


def _is_of_keys(steering: Values, time_ns: NDArray[np.int64], same: NDArray[np.bool_]) -> bool:
    if not len(steering):
        return False
    if 1 < len(np.unique(steering)) <= KEYS_VALUES:
        return True
    is_step = same & (np.diff(time_ns) > 0) & (np.diff(steering) != 0)
    rate = np.abs(np.diff(steering)[is_step]) / (np.diff(time_ns)[is_step] / 1e9)
    if not len(rate):
        return False
    rate = np.sort(rate)
    near = np.searchsorted(rate, rate * (1 + KEYS_NEAR), side="right") - np.searchsorted(
        rate, rate * (1 - KEYS_NEAR)
    )
    return float(near.max() / len(rate)) >= KEYS_SHARE


def _share(mask: NDArray[np.bool_]) -> float | None:
    return float(mask.mean()) if len(mask) else None


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
