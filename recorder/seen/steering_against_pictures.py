"""Stretches of a session in which the car turns one way, and the steering the other.

The car's poses show its turning; without poses, its pictures do. Pictures are less certain: in a gentle bend, the
far field may move to the other side.

The labels there are wrong: of another drive, mirrored, or delayed. On straight roads, these errors stay hidden. No
network is needed.

Thresholds were set on four recordings of people (5,667 rows): they find none of these rows, and find mirrored
stretches of 10 s if they have bends (benchmarks/README.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.stretches import stretches
from recorder.rows.label_plan import IN_TIME_S
from recorder.rows.row_quality import States, Values, elapsed_s
from recorder.seen.far_field import WIDTH_PX, FarField, PictureLog, rows_apart

_WINDOW_S: Final = 5.0  # in shorter windows, corrections on a straight road look opposed
_MIN_PAIRS: Final = 15  # in a window
_MIN_S: Final = 20.0
"""The least driving that shows turning. With 12 s of hairpins, one correct drive in eight was reported."""
_OPPOSED: Final = -0.3  # a correlation
_MIN_YAW: Final = 0.25  # share of the session's mean square, from which on the car visibly turns
_MIN_STEERING: Final = 0.1  # the same for the steering
_MAX_RADPS: Final = 2.0  # a car that turns faster was put elsewhere; built-in cars stay below 0.8
_LAGS_S: Final = np.arange(-20, 21) * 0.05
_USUAL: Final = 0.35
"""The least median correlation of windows; below, the pictures do not show how the car turns. The correlation of
the whole session (`recorder.seen.steering_lag`) would suffer from a sixth of wrong labels."""
_MOST: Final = 0.4
"""The least correlation of a mirrored part and of the rest, with opposite signs. Correct sessions have at most
0.15, recordings of people with a mirrored half 0.43 to 0.9."""
_PARTS: Final = 20


def against_pictures(
    log: PictureLog, states: States, on_pairs: Callable[[int], object] = lambda count: None
) -> NDArray[np.bool_]:
    """The rows (N,) whose steering contradicts the car's turning; none if nothing shows how the car turned.

    Without poses in `states`, decodes the centre camera's pictures: one core takes a second for 4,000 rows. Calls
    `on_pairs` with the number of pairs done since the last call.
    """
    is_against = np.zeros(len(states.row), np.bool_)
    time_s = elapsed_s(states.time_ns)
    is_sound = np.abs(states.steering) <= 1  # False for NaN too
    pairs = rows_apart(states, time_s)
    pairs = pairs[is_sound[pairs].all(axis=1)]
    turn = _turn_of_poses(states, pairs)
    max_turn = _MAX_RADPS * np.diff(time_s[pairs])[:, 0]
    if turn is None:
        shown = FarField(log, states)
        turn = np.full(len(pairs), np.nan)
        for number, (first, second) in enumerate(pairs.tolist()):
            turn[number] = shown.yaw_px(first, second)
            on_pairs(1)
        max_turn[:] = WIDTH_PX / 4  # larger shifts are no match
    is_known = np.abs(turn) < max_turn  # False for NaN
    pairs, turn = pairs[is_known], turn[is_known]
    if np.diff(time_s[pairs])[:, 0].sum() < _MIN_S:
        return is_against
    yaw = turn / np.diff(time_s[pairs])[:, 0]
    speed = np.where(np.isfinite(states.speed_mph), states.speed_mph, 1.0)
    middle_s = time_s[pairs].mean(axis=1)
    turning = (states.steering * speed)[is_sound]
    steered = np.stack([np.interp(middle_s + lag_s, time_s[is_sound], turning) for lag_s in _LAGS_S])
    windows = _windows(middle_s, yaw)
    usual = [float(np.median(windows.correlations(row))) if len(windows.first) else 0.0 for row in steered]
    best = int(np.argmax(usual))
    if usual[best] >= _USUAL:
        opposed = windows.opposed(steered[best])
    else:
        earliest_s, latest_s = IN_TIME_S
        is_in_time = (earliest_s <= _LAGS_S) & (latest_s >= _LAGS_S)
        opposed = _mirrored_part(steered[is_in_time], yaw, np.diff(time_s[pairs])[:, 0])
    for first, last in opposed:
        is_against[pairs[first, 0] : pairs[last, 1] + 1] = True
    return is_against


def _turn_of_poses(states: States, pairs: NDArray[np.int64]) -> Values | None:
    """The car's turn to the right between the rows of each pair (N,), in radians; None if most pairs lack a pose,
    or if the heading never changes."""
    if states.heading_rad is None or not len(pairs):
        return None
    turn: Values = (np.pi - np.diff(states.heading_rad[pairs])[:, 0]) % (2 * np.pi) - np.pi
    is_known = np.isfinite(turn)
    return turn if is_known.mean() > 0.5 and turn[is_known].any() else None


def _mirrored_part(steered: Values, yaw: Values, between_s: Values) -> list[tuple[int, int]]:
    """The part of a session that is mirrored, as the first and the last pair, if it is so long that the median of
    windows does not show which way the car turns."""
    count = len(yaw)
    edges = np.linspace(0, count, _PARTS + 1).astype(np.int64)
    first, last = (edges[at] for at in np.triu_indices(_PARTS + 1, 1))
    part = _Windows(first, last, yaw)
    rest = _Windows(last, first + count, np.tile(yaw, 2))  # from the part's end, around to its begin
    is_long = (part.sums(between_s) >= _MIN_S) & (rest.sums(np.tile(between_s, 2)) >= _MIN_S)
    apart = [np.minimum(-part.correlations(row), rest.correlations(np.tile(row, 2))) * is_long for row in steered]
    lag, at = np.unravel_index(np.argmax(apart), (len(steered), len(first)))
    if apart[lag][at] < _MOST:
        return []
    step = count // _PARTS
    begin, end = max(int(first[at]) - step, 0), min(int(last[at]) + step, count)
    return [_sharpest(steered[lag] * yaw, begin, end - 1)]


@dataclass(frozen=True)
class _Windows:
    """Windows over the pairs of pictures (N,). In each, the car visibly turns."""

    first: NDArray[np.int64]  # (W,) positions of the first pairs
    last: NDArray[np.int64]  # (W,) positions after the last pairs
    yaw: Values  # (N,)

    def sums(self, values: Values) -> Values:
        until = np.concatenate([[0.0], np.cumsum(values)])
        total: Values = until[self.last] - until[self.first]
        return total

    def correlations(self, steered: Values) -> Values:
        """The correlation in each window (W,), around 0 instead of the mean, so that long bends count."""
        size = np.sqrt(self.sums(steered**2) * self.sums(self.yaw**2))
        correlation: Values = np.divide(
            self.sums(steered * self.yaw), size, out=np.zeros(len(size)), where=size > 1e-9
        )
        return correlation

    def opposed(self, steered: Values) -> list[tuple[int, int]]:
        """The first and the last of each stretch of pairs in which steering and turning have opposite signs."""
        is_opposed = self.correlations(steered) < _OPPOSED
        is_opposed &= self.sums(steered**2) > _MIN_STEERING * np.mean(steered**2) * (self.last - self.first)
        # the number of windows over each pair: those begun minus those ended
        change = np.zeros(len(steered) + 1)
        np.add.at(change, self.first[is_opposed], 1)
        np.add.at(change, self.last[is_opposed], -1)
        return [_sharpest(steered * self.yaw, *stretch) for stretch in stretches(np.cumsum(change)[:-1] > 0)]


def _windows(time_s: Values, yaw: Values) -> _Windows:
    first = np.arange(len(time_s))
    last = np.searchsorted(time_s, time_s + _WINDOW_S)
    every = _Windows(first, last, yaw)
    turns = every.sums(yaw**2) > _MIN_YAW * np.mean(yaw**2) * (last - first)
    turns &= last - first >= _MIN_PAIRS
    turns &= time_s[last - 1] - time_s[first] >= 0.9 * _WINDOW_S
    return _Windows(first[turns], last[turns], yaw)


def _sharpest(product: Values, first: int, last: int) -> tuple[int, int]:
    """The part of a stretch with the lowest sum: windows are longer than the contradiction."""
    until = np.concatenate([[0.0], np.cumsum(product[first : last + 1])])
    highest = np.maximum.accumulate(until)
    end = int(np.argmin(until - highest))
    begin = int(np.argmax(until[: end + 1]))
    return first + begin, first + max(end - 1, begin)
