"""Labels: the steering that a network learns for each frame, as recorded, smoothed, or a little later.

People with keyboards steer in steps, and late: the picture comes before the steering that it requires.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common.car import SPEED_RANGE_MPH
from dataset.frames.distinct_rows import number_distinct
from dataset.frames.drivers import DRIVERS
from dataset.frames.frame_flags import is_excluded, is_unusable
from dataset.frames.frames_file import SPLITS, codes
from recorder.rows.causes import NOT_LEARNT
from recorder.rows.condition import lists_with
from recorder.rows.label_plan import LabelPlan
from recorder.rows.row_quality import GAP_S

_ONE: Final = 1 << 40
"""A steering of 1 as an integer: sums of integers are exact, so that stretches do not influence each other."""

HELD_MPH: Final = 1.0  # if the speed is this close to the set speed, the driver keeps the set speed

Steering = NDArray[np.float64]
Times = NDArray[np.int64]


def planned_labels(frames: pa.Table, plan: LabelPlan) -> tuple[Steering, NDArray[np.bool_]]:
    """The steering to learn for each frame of a session (N,), as from `labels_of`, and a mask (N,) of left-out
    frames: crashes, driving backwards, manoeuvres, and a parked car.

    No label depends on another driver's steering, on another split, or on frames that are unusable, tagged
    `exclude` or left out.
    """
    is_odd = _is_odd(frames, plan)
    return labels_of(frames, _is_good(frames), _side(frames, is_odd), plan.smooth_s, plan.shift_s), is_odd


def planned_speed_mph(
    frames: pa.Table, plan: LabelPlan, ahead_s: float, slower_mph: Sequence[float] = ()
) -> NDArray[np.float64]:
    """The speed `ahead_s` seconds after each frame of a session (N,); NaN if this time is beyond a border (see
    `labels_of`), or if the speed is unknown.

    `slower_mph` are the set speeds of this session's driver that are below those of other drivers. While the
    driver keeps such a speed, the road may allow more, so the label is NaN. (The mean of all speeds at a place
    would be too slow on straights.)
    """
    speed_mph: NDArray[np.float64] = frames["speed_mph"].to_numpy()
    is_speed = (speed_mph >= SPEED_RANGE_MPH[0]) & (speed_mph <= SPEED_RANGE_MPH[1])  # False for NaN
    speed_mph = np.where(is_speed, speed_mph, np.nan)
    if not len(frames):
        return speed_mph
    rows = _rows_of(frames, _is_good(frames) & is_speed, _side(frames, _is_odd(frames, plan)))
    of_rows = np.where(rows.is_usable, speed_mph[rows.frame], np.nan)
    speed_mph = _shifted(of_rows, rows.stretches, round(ahead_s * 1e9))[rows.of_frame]
    for set_mph in slower_mph:
        speed_mph[np.abs(speed_mph - set_mph) < HELD_MPH] = np.nan
    return speed_mph


def recorded_throttle(frames: pa.Table) -> NDArray[np.float64]:
    """The throttle minus the brake of each frame (N,), -1..1; NaN for other values. All NaN if both are 0 in the
    whole session: then they were not recorded, because no car drives without throttle."""
    pedals = [frames[name].to_numpy() for name in ("throttle", "brake")]
    throttle: NDArray[np.float64] = np.subtract(*pedals)
    has_pedals = any(pedal.any() for pedal in pedals)
    return np.where((np.abs(throttle) <= 1) & has_pedals, throttle, np.nan)


def _is_good(frames: pa.Table) -> NDArray[np.bool_]:
    return ~is_unusable(frames) & ~is_excluded(frames)


def _is_odd(frames: pa.Table, plan: LabelPlan) -> NDArray[np.bool_]:
    return lists_with(frames["flags"], *NOT_LEARNT) & plan.without_crashes


def _side(frames: pa.Table, is_odd: NDArray[np.bool_]) -> NDArray[np.int8]:
    """A code (N,) of split, driver and `is_odd`: no label depends on frames with another code."""
    side: NDArray[np.int8] = codes(frames["split"], SPLITS) + 4 * codes(frames["driver"], DRIVERS)
    return side + 16 * is_odd.astype(np.int8)


def labels_of(
    frames: pa.Table, is_usable: NDArray[np.bool_], split: NDArray[np.int8], smooth_s: float, shift_s: float
) -> Steering:
    """The steering to learn for each frame of a session (N,), -1..1; NaN without a label.

    `is_usable` (N,) marks the usable frames, `split` (N,) has a code of their split (`_side`). A border is a row
    without a usable frame, an edge of a drive, a gap in time, or a change of `split`: no label depends on frames
    beyond a border. First, the steering is smoothed: the mean over the rows within half of `smooth_s` on both
    sides, up to the border. Then the label is the steering `shift_s` seconds later (earlier, if negative),
    interpolated linearly between rows; NaN if this time is beyond the border. If both are 0, the label is the
    recorded steering.
    """
    steering: Steering = frames["steering"].to_numpy()
    if (smooth_s == 0 and shift_s == 0) or not len(frames):
        return steering
    rows = _rows_of(frames, is_usable, split)
    labels = np.where(rows.is_usable, steering[rows.frame], 0.0)  # an unusable row is a stretch of its own
    if smooth_s:
        labels = _smoothed(labels, rows.stretches, round(smooth_s * 1e9 / 2))
    if shift_s:
        labels = _shifted(labels, rows.stretches, round(shift_s * 1e9))
    labels[~rows.is_usable] = np.nan
    return labels[rows.of_frame]


@dataclass(frozen=True)
class _Rows:
    """The R rows of a session's N frames. The frames of all cameras at a moment share a row."""

    of_frame: NDArray[np.int32]  # (N,): the row of each frame
    frame: NDArray[np.int64]  # (R,): a frame of each row
    is_usable: NDArray[np.bool_]  # (R,)
    stretches: _Stretches


def _rows_of(frames: pa.Table, is_usable: NDArray[np.bool_], split: NDArray[np.int8]) -> _Rows:
    # sorted by time: a log that was still growing may have late pictures after others
    number, rows = number_distinct(*(frames[name].to_numpy() for name in ("log_time_ns", "row")))
    row_is_usable = np.bincount(number, is_usable, len(rows)) > 0
    drive = frames["drive"].to_numpy()[rows]
    step_ns = np.diff(frames["log_time_ns"].to_numpy()[rows])
    is_border = (
        (step_ns < 0)
        | (step_ns > GAP_S * 1e9)
        | (np.diff(drive) != 0)
        | (np.diff(split[rows]) != 0)
        | ~(row_is_usable[1:] & row_is_usable[:-1])
    )
    return _Rows(number, rows, row_is_usable, _Stretches.between(step_ns, is_border))


@dataclass(frozen=True)
class _Stretches:
    """Rows between borders; arrays (R,)."""

    time_ns: Times  # never decreases, also at borders; differences within a stretch are those of the log
    first: NDArray[np.int64]  # the first row of the row's stretch
    last: NDArray[np.int64]  # the last row of the row's stretch

    @classmethod
    def between(cls, step_ns: Times, is_border: NDArray[np.bool_]) -> _Stretches:
        """From the times between neighbouring rows, (R - 1,), and a mask of the borders between them, (R - 1,)."""
        time_ns = np.concatenate([[0], np.cumsum(np.where(is_border, 0, step_ns))])
        starts = np.concatenate([[0], np.flatnonzero(is_border) + 1])
        ends = np.append(starts[1:], len(time_ns))
        first, last = (np.repeat(edge, ends - starts) for edge in (starts, ends - 1))
        return cls(time_ns, first, last)


def _smoothed(steering: Steering, stretches: _Stretches, reach_ns: int) -> Steering:
    """The mean steering over the rows of the same stretch within `reach_ns` of each row."""
    time_ns = stretches.time_ns
    begin = np.maximum(np.searchsorted(time_ns, time_ns - reach_ns, side="left"), stretches.first)
    end = np.minimum(np.searchsorted(time_ns, time_ns + reach_ns, side="right"), stretches.last + 1)
    total = np.concatenate([[0], np.cumsum(np.rint(steering * _ONE).astype(np.int64))])
    mean = (total[end] - total[begin]) / (end - begin) / _ONE
    starts = np.unique(stretches.first)
    lowest, highest = (extreme.reduceat(steering, starts) for extreme in (np.minimum, np.maximum))
    stretch = np.searchsorted(starts, stretches.first)
    smoothed: Steering = np.clip(mean, lowest[stretch], highest[stretch])
    return smoothed


def _shifted(steering: Steering, stretches: _Stretches, shift_ns: int) -> Steering:
    """The steering `shift_ns` later in the same stretch; NaN if the stretch has ended by then."""
    time_ns = stretches.time_ns
    wanted_ns = time_ns + shift_ns
    is_within = (time_ns[stretches.first] <= wanted_ns) & (wanted_ns <= time_ns[stretches.last])
    after = np.clip(np.searchsorted(time_ns, wanted_ns), stretches.first, stretches.last)
    before = np.maximum(after - 1, stretches.first)
    apart_ns = np.maximum(time_ns[after] - time_ns[before], 1)  # 0 only if both are the first row of a stretch
    share = (time_ns[after] - wanted_ns) / apart_ns
    between = steering[after] - share * (steering[after] - steering[before])
    return np.where(is_within, between, np.nan)
