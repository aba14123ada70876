"""Odd stretches that pictures show: steering that contradicts them, or never changes while the car turns. They
also decide whether a car drove backwards, if its numbers leave that open: things ahead grow when the car drives
forwards.

The car's poses show its turning; without poses, its pictures do. Pictures are less certain: in a gentle bend, the
far field may move to the other side. Where the steering goes the other way, labels are of another drive, mirrored,
or delayed. On straight roads, these errors stay hidden. No network is needed.

Thresholds were set on four recordings of people (5,667 rows): they find none of these rows, and find mirrored
stretches of 10 s if they have bends (benchmarks/README.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import MPS_PER_MPH
from common.progress import progress_bar, progress_task
from common.stretches import stretches, within
from recorder.rows.label_plan import IN_TIME_S
from recorder.rows.odd_stretches import OddStretch, stretch_of
from recorder.rows.row_quality import STANDING_MPH, States, Values, elapsed_s
from recorder.seen.far_field import WIDTH_PX, CenterPictures, FarField, PictureLog, rows_apart

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
the whole session (`recorder.log.known_lag`) would suffer from a sixth of wrong labels."""
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


_CONTROLS: Final = 20
_CONTROL_S: Final = 5.0
_MIN_CONTROLS: Final = 5
_MAX_WRONG: Final = 0.05
"""The share of stretches known to go forwards that may look backwards. On the built-in mountain, one in eight
does: its pictures are not used."""
_SAMPLED_PAIRS: Final = 300
_STILL: Final = 0.5  # share of the session's spread of turning; with constant steering, a car turns evenly


def with_pictures(log: PictureLog, states: States, odd: Sequence[OddStretch]) -> list[OddStretch]:
    """The odd stretches `odd` of a log's rows, and those that its centre camera's pictures show. Decodes all of
    them."""
    about = "comparing steering with pictures"
    with progress_bar() as bar, progress_task(bar, about, len(states.row)) as advance:
        against = against_pictures(log, states, advance)
    why = "the car turns the other way"
    shown = [
        replace(stretch_of(states, first, last, "steering_against_pictures", why, is_sure=True), is_shown=True)
        for first, last in stretches(against)
    ]
    time_s = elapsed_s(states.time_ns)
    unsure_kinds = {stretch.kind for stretch in odd if not stretch.is_sure}
    direction = _direction(log, states, time_s, odd) if "backwards" in unsure_kinds else None
    turning = _turning(log, states, time_s) if "stuck_steering" in unsure_kinds else None
    for stretch in odd:
        judged: OddStretch | None = stretch
        first, last = (int(np.flatnonzero(states.row == row)[0]) for row in (stretch.first_row, stretch.last_row))
        if stretch.kind == "backwards" and not stretch.is_sure and direction is not None:
            judged = _by_growth(stretch, direction(first, last))
        elif stretch.kind == "stuck_steering" and turning is not None and turning(first, last) > _STILL:
            judged = replace(
                stretch, is_sure=True, is_shown=True, cause=f"{stretch.cause}, while the pictures turn"
            )
        if judged is not None:
            shown.append(judged)
    return sorted(shown, key=lambda stretch: (stretch.first_row, stretch.last_row))


def _by_growth(stretch: OddStretch, grown: float) -> OddStretch | None:
    """A stretch that may be backwards, judged by its pictures; None if the car drives forwards."""
    if grown < -_SHOWN_GROWTH:
        why = f"{stretch.cause.removeprefix('or downhill? ')}; the pictures shrink"
        return replace(stretch, is_sure=True, is_shown=True, cause=why)
    return None if grown > _SHOWN_GROWTH else stretch


def _direction(
    log: PictureLog, states: States, time_s: Values, odd: Sequence[OddStretch]
) -> Callable[[int, int], float] | None:
    """A function for the growth between two rows; None if the session's pictures do not show its direction."""
    pictures = CenterPictures(log, states)
    is_odd = within(states.row, [(stretch.first_row, stretch.last_row) for stretch in odd])
    drives = np.flatnonzero(~is_odd & (np.abs(states.speed_mph) >= STANDING_MPH))
    controls = list[float]()
    for first in np.unique(drives[np.linspace(0, len(drives) - 1, _CONTROLS).astype(int)] if len(drives) else []):
        last = int(np.searchsorted(time_s, time_s[first] + _CONTROL_S)) - 1
        if not is_odd[first : last + 1].any():
            controls.append(growth(pictures, states, time_s, int(first), last))
    growths = np.array([value for value in controls if np.isfinite(value)])
    if len(growths) < _MIN_CONTROLS or (growths < 0).mean() > _MAX_WRONG:
        return None
    return partial(growth, pictures, states, time_s)


def _turning(log: PictureLog, states: States, time_s: Values) -> Callable[[int, int], float] | None:
    """A function for the spread of the car's turning between two rows, as a share of the session's; None if the
    pictures do not show the turning."""
    shown = FarField(log, states)
    pairs = rows_apart(states, time_s)

    def turns(row_pairs: NDArray[np.int64]) -> Values:
        yaw_px = np.array([shown.yaw_px(first, second) for first, second in row_pairs.tolist()])
        speed = np.where(np.isfinite(states.speed_mph), states.speed_mph, 1.0)[row_pairs[:, 0]]
        distance = np.diff(time_s[row_pairs])[:, 0] * speed
        curvature: Values = (yaw_px / distance)[np.abs(yaw_px) < WIDTH_PX / 4]  # False for NaN
        return curvature

    sampled = turns(pairs[:: max(1, len(pairs) // _SAMPLED_PAIRS)])
    if len(sampled) < _MIN_PAIRS or not _spread(sampled) > 0:
        return None

    def spread(first: int, last: int) -> float:
        part = turns(pairs[(pairs[:, 0] >= first) & (pairs[:, 1] <= last)])
        return _spread(part) / _spread(sampled) if len(part) >= _MIN_PAIRS else 0.0

    return spread


def _spread(values: Values) -> float:
    """Half the distance between the 16th and the 84th percentile: a standard deviation without outliers."""
    low, high = np.percentile(values, (16, 84))
    return float(high - low) / 2


# Of two pictures, first the earlier and then the later one is enlarged: the better match shows the direction. The
# car has to move by metres, past things that stand out.
_APART_M: Final = 2.0
_FARTHEST_S: Final = 1.5
_SCALES: Final = (1.05, 1.1, 1.17)  # growth of things 10 to 40 m away
_BAND: Final = (0.3, 0.62)  # shares of the height: the horizon and the far road
_MIN_GROWTHS: Final = 4
_SHOWN_GROWTH: Final = 0.05
"""In three recordings of people, nine in ten stretches of 3 to 6 s have more than 0.11, and none less than 0.01.
The same pictures in reverse order have the negative values."""

Gray = NDArray[np.uint8]


def growth(pictures: CenterPictures, states: States, time_s: Values, first: int, last: int) -> float:
    """The growth of the pictures between two row positions, -1..1. Above `_SHOWN_GROWTH`, the car drives forwards;
    below `-_SHOWN_GROWTH`, backwards. NaN for fewer than `_MIN_GROWTHS` pairs."""
    way_m = np.abs(np.nan_to_num(states.speed_mph)) * MPS_PER_MPH
    driven_m = np.concatenate([[0.0], np.cumsum(way_m[:-1] * np.minimum(np.diff(time_s), 1.0))])
    later = np.searchsorted(driven_m, driven_m + _APART_M).tolist()
    growths = list[float]()
    position = first
    while (following := max(later[position], position + 1)) <= last:
        if time_s[following] - time_s[position] <= _FARTHEST_S:
            before, after = (pictures.gray(row) for row in (position, following))
            if before is not None and after is not None and before.shape == after.shape:
                growths.append(_growth(before, after))
            position = following
        else:
            position += 1
    finite = [value for value in growths if np.isfinite(value)]
    return float(np.mean(finite)) if len(finite) >= _MIN_GROWTHS else float("nan")


def _growth(before: Gray, after: Gray) -> float:
    top, bottom = (round(share * before.shape[0]) for share in _BAND)
    before, after = before[top : max(bottom, top + 1)], after[top : max(bottom, top + 1)]
    forwards = max(_likeness(_enlarged(before, scale), after) for scale in _SCALES)
    backwards = max(_likeness(before, _enlarged(after, scale)) for scale in _SCALES)
    both = forwards + backwards
    return (forwards - backwards) / both if forwards > 0 and backwards > 0 else float("nan")


def _enlarged(picture: Gray, scale: float) -> Gray:
    height, width = picture.shape
    zoom = cv2.getRotationMatrix2D((width / 2, height / 2), 0, scale)
    return np.asarray(cv2.warpAffine(picture, zoom, (width, height), borderMode=cv2.BORDER_REPLICATE), np.uint8)


def _likeness(first: Gray, second: Gray) -> float:
    edges = [cv2.Sobel(cv2.GaussianBlur(picture, (3, 3), 0), cv2.CV_32F, 1, 0) for picture in (first, second)]
    window = cv2.createHanningWindow(first.shape[::-1], cv2.CV_32F)
    return cv2.phaseCorrelate(edges[0], edges[1], window)[1]
