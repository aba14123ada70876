"""Odd stretches that pictures show: steering that contradicts them, or never changes while the car turns. They
also decide whether a car drove backwards, if its numbers leave that open: things ahead grow when the car drives
forwards."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import MPS_PER_MPH
from common.progress import progress_bar, progress_task
from common.stretches import stretches, within
from recorder.rows.odd_stretches import OddStretch, stretch_of
from recorder.rows.row_quality import STANDING_MPH, States, Values, elapsed_s
from recorder.seen.far_field import WIDTH_PX, CenterPictures, FarField, PictureLog, rows_apart
from recorder.seen.steering_against_pictures import against_pictures

_CONTROLS: Final = 20
_CONTROL_S: Final = 5.0
_MIN_CONTROLS: Final = 5
_MAX_WRONG: Final = 0.05
"""The share of stretches known to go forwards that may look backwards. On the built-in mountain, one in eight
does: its pictures are not used."""
_SAMPLED_PAIRS: Final = 300
_MIN_PAIRS: Final = 15
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
