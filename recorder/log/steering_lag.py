"""The lag of a session's steering behind the car's own turning, which its pictures show.

What is far away moves across the picture as the car turns, and hardly otherwise. So the shift of the far field
from one picture to the next is the car's yaw, whatever the log says of its steering, and the steering times the
speed is proportional to it at the right moment. In a sound recording the car turns at once, or up to 0.4 s after
the steering; labels that were delayed, or pictures that were, give themselves away.

It is the lag of the record, not a person's: how long somebody takes to react, no motion tells, because the car
follows the hand and not the road.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from recorder.errors import LogError
from recorder.log.reader import Log
from recorder.log.row_quality import States, Values, elapsed_s
from recorder.log.steering_habits import SteeringLag
from recorder.log.topics import camera_topic
from recorder.pictures.picture_size import can_be_decoded

MOST_PICTURES: Final = 1500
"""That are decoded, of however long a session: half a second of one core."""
_PARTS: Final = 10  # of a longer session, evenly spread
_APART_S: Final = 0.095  # between two pictures: in less, what is far moves by a fraction of a pixel
_FARTHEST_S: Final = 0.3  # in more, it has left the picture
_FAR: Final = (0.34, 0.5)  # of the height: about the horizon, above the road near by
_WIDTH_PX: Final = 160
_LAGS_S: Final = np.arange(-20, 21) * 0.05
_SLOWEST_MPH: Final = 5.0
_LEAST_PAIRS: Final = 200
_LEAST_CORRELATION: Final = 0.35
"""Recordings have 0.4 to 0.94."""
_AGREE_S: Final = 0.11  # both halves of the pairs

Picture = NDArray[np.float32]


def measure_lag(log: Log) -> SteeringLag | None:
    """Measure in the centre camera's pictures; None where they do not tell: too few of them from a moving car, too
    far apart, or nothing in them that moves as the steering says. Raises LogError for a log whose rows cannot be
    read; a picture that cannot is passed over."""
    states = States.of(log.vehicle())
    states = _part_of(states, np.abs(states.steering) <= 1)  # False for NaN too
    time_s = elapsed_s(states.time_ns)
    pairs = _pairs(states, time_s)
    if len(pairs) < _LEAST_PAIRS:
        return None
    shown = _FarField(log, states)
    yaw_px: list[float] = [shown.yaw_px(first, second) for first, second in pairs.tolist()]
    return _best_lag(states, time_s, pairs, np.array(yaw_px), len(shown.seen))


def _pairs(states: States, time_s: Values) -> NDArray[np.int64]:
    """Positions (N, 2) of rows of the moving car, so far apart that a turn can be seen between their pictures."""
    later = np.searchsorted(time_s, time_s + _APART_S).tolist()
    chain, at = list[int](), 0
    while at < len(later):
        chain.append(at)
        at = max(later[at], at + 1)
    rows = np.array(chain, np.int64)
    if len(rows) > MOST_PICTURES:
        each = MOST_PICTURES // _PARTS
        starts = np.linspace(0, len(rows) - each, _PARTS).astype(np.int64)
        taken = (starts[:, None] + np.arange(each)).ravel()
        pairs = np.stack([rows[taken[:-1]], rows[taken[1:]]], axis=1)[np.diff(taken) == 1]
    else:
        pairs = np.stack([rows[:-1], rows[1:]], axis=1)
    is_near = np.diff(time_s[pairs])[:, 0] <= _FARTHEST_S
    is_slow = (states.speed_mph[pairs] < _SLOWEST_MPH).any(axis=1)  # False for an unknown speed
    chosen: NDArray[np.int64] = pairs[is_near & ~is_slow]
    return chosen


class _FarField:
    """What is far away, in the centre camera's pictures."""

    def __init__(self, log: Log, states: States) -> None:
        self._log = log
        found = log.pictures(camera_topic("center"))
        places = zip(*(each.tolist() for each in (found.offset, found.length, found.chunk)), strict=True)
        moments = zip(found.sequence.tolist(), found.log_time_ns.tolist(), strict=True)
        by_moment = dict(zip(moments, places, strict=True))
        rows = zip(states.row.tolist(), states.time_ns.tolist(), strict=True)
        self._places = [by_moment.get(moment) for moment in rows]
        self._last: tuple[int, Picture | None] = (-1, None)
        self.seen = set[int]()

    def yaw_px(self, first: int, second: int) -> float:
        """How far the car turned to the right between two rows, in columns of the picture; NaN if none tells."""
        before, after = (self._of(row) for row in (first, second))
        if before is None or after is None or before.shape != after.shape:
            return float("nan")
        window = cv2.createHanningWindow(before.shape[::-1], cv2.CV_32F)
        (shift_px, _), _ = cv2.phaseCorrelate(before, after, window)
        return -shift_px  # the world moves to the left

    def _of(self, row: int) -> Picture | None:
        if self._last[0] != row:
            self._last = row, self._decoded(row)
        return self._last[1]

    def _decoded(self, row: int) -> Picture | None:
        """Upright edges about the horizon."""
        place = self._places[row]
        if place is None:
            return None
        try:
            data = self._log.read(*place)
            if not can_be_decoded(data):
                return None
            picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_REDUCED_GRAYSCALE_2)
        except (LogError, cv2.error):
            return None
        if picture is None:
            return None
        self.seen.add(row)
        height, width = picture.shape
        top, bottom = (round(share * height) for share in _FAR)
        size = (_WIDTH_PX, max(1, round((bottom - top) * _WIDTH_PX / width)))
        far = cv2.resize(picture[top : max(bottom, top + 1)], size, interpolation=cv2.INTER_AREA)
        return cv2.Sobel(cv2.GaussianBlur(far, (3, 3), 0), cv2.CV_32F, 1, 0).astype(np.float32, copy=False)


def _best_lag(
    states: States, time_s: Values, pairs: NDArray[np.int64], yaw_px: Values, pictures: int
) -> SteeringLag | None:
    """The lag at which steering times speed goes best with the yaw, if both halves of the pairs agree on it."""
    between_s = np.diff(time_s[pairs])[:, 0]
    middle_s = time_s[pairs].mean(axis=1)
    speed = np.where(np.isfinite(states.speed_mph), states.speed_mph, 1.0)
    asked = np.stack([np.interp(middle_s + lag_s, time_s, states.steering * speed) for lag_s in _LAGS_S])
    known = np.isfinite(yaw_px) & (np.abs(yaw_px) < _WIDTH_PX / 4)  # else it has found nothing in common
    if known.sum() < _LEAST_PAIRS:
        return None
    yaw = yaw_px[known] / between_s[known]
    asked = asked[:, known]
    half = np.arange(len(yaw)) >= len(yaw) // 2
    curves = [_correlations(asked[:, part], yaw[part]) for part in (half | ~half, half, ~half)]
    best, *halves = (int(np.abs(curve).argmax()) for curve in curves)
    correlation = float(curves[0][best])
    is_at_edge = best in (0, len(_LAGS_S) - 1)
    agree = all(abs(_LAGS_S[each] - _LAGS_S[best]) <= _AGREE_S for each in halves)
    if abs(correlation) < _LEAST_CORRELATION or is_at_edge or not agree:
        return None
    return SteeringLag(round(float(_LAGS_S[best]), 2), round(correlation, 3), pictures)


def _correlations(asked: Values, yaw: Values) -> Values:
    """Of each row of `asked` (lags, N) with `yaw` (N,); 0 where one of them does not vary."""
    asked, yaw = asked - asked.mean(axis=1, keepdims=True), yaw - yaw.mean()
    size = np.sqrt((asked**2).sum(axis=1) * (yaw**2).sum())
    found: Values = np.divide(asked @ yaw, size, out=np.zeros(len(asked)), where=size > 1e-9)
    return found


def _part_of(states: States, mask: NDArray[np.bool_]) -> States:
    return States(*(column[mask] for column in vars(states).values()))
