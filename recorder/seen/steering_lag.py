"""The lag of a session's steering behind the car's turning, which its pictures show.

Steering times speed is proportional to the car's yaw, and the far field of the pictures shows the yaw
(`recorder.seen.far_field`). In a correct recording, the car turns up to 0.4 s after the steering. Another lag
shows that labels or pictures were delayed.

A person's reaction time is not part of this lag: the car follows the hand, not the road.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from recorder.rows.row_quality import States, Values, elapsed_s
from recorder.rows.steering_habits import SteeringLag
from recorder.seen.far_field import WIDTH_PX, FarField, PictureLog, rows_apart

MAX_PICTURES: Final = 1500  # decoded, even in long sessions: half a second of one core
_STEP_S: Final = 0.05
_LAGS_S: Final = np.arange(-60, 61) * _STEP_S
_MIN_PAIRS: Final = 200
_MIN_CORRELATION: Final = 0.35  # recordings have 0.4 to 0.94
_AGREE_S: Final = 0.11  # both halves of the pairs
_PARTS: Final = 20
_RESAMPLINGS: Final = 200
_SURE: Final = 0.95


def measure_lag(log: PictureLog, states: States) -> SteeringLag | None:
    """Measure the lag in the centre camera's pictures of these rows, without unreadable ones. None if they do not
    show it: too few pictures of a moving car, too far apart, or nothing that moves with the steering."""
    states = states.part(np.abs(states.steering) <= 1)  # False for NaN too
    time_s = elapsed_s(states.time_ns)
    pairs = rows_apart(states, time_s, MAX_PICTURES)
    if len(pairs) < _MIN_PAIRS:
        return None
    shown = FarField(log, states)
    yaw_px: list[float] = [shown.yaw_px(first, second) for first, second in pairs.tolist()]
    return _best_lag(states, time_s, pairs, np.array(yaw_px), len(shown.pictures.decoded_rows))


def _best_lag(
    states: States, time_s: Values, pairs: NDArray[np.int64], yaw_px: Values, pictures: int
) -> SteeringLag | None:
    """The lag at which steering times speed fits the yaw best, if both halves of the pairs agree."""
    between_s = np.diff(time_s[pairs])[:, 0]
    middle_s = time_s[pairs].mean(axis=1)
    speed = np.where(np.isfinite(states.speed_mph), states.speed_mph, 1.0)
    steered = np.stack([np.interp(middle_s + lag_s, time_s, states.steering * speed) for lag_s in _LAGS_S])
    is_known = np.abs(yaw_px) < WIDTH_PX / 4  # False for NaN; larger shifts are no match
    if is_known.sum() < _MIN_PAIRS:
        return None
    yaw = yaw_px[is_known] / between_s[is_known]
    steered = steered[:, is_known]
    half = np.arange(len(yaw)) >= len(yaw) // 2
    curves = [_correlations(steered[:, part], yaw[part]) for part in (half | ~half, half, ~half)]
    best, *halves = (int(np.abs(curve).argmax()) for curve in curves)
    correlation = float(curves[0][best])
    is_at_edge = best in (0, len(_LAGS_S) - 1)
    agree = all(abs(_LAGS_S[of_half] - _LAGS_S[best]) <= _AGREE_S for of_half in halves)
    if abs(correlation) < _MIN_CORRELATION or is_at_edge or not agree:
        return None
    resampled_s = _LAGS_S[_resampled_best(steered, yaw)]
    margin_s = max(float(np.quantile(np.abs(resampled_s - _LAGS_S[best]), _SURE)), _STEP_S)
    return SteeringLag(round(float(_LAGS_S[best]), 2), round(correlation, 3), pictures, round(margin_s, 2))


def _resampled_best(steered: Values, yaw: Values) -> NDArray[np.int64]:
    """The position of the best lag in each of many drives, resampled from consecutive parts of this one (block
    bootstrap: Kuensch 1989, Annals of Statistics 17). Smooth steering fits the yaw at many lags."""
    starts = np.linspace(0, len(yaw), _PARTS, endpoint=False).astype(np.int64)
    times = np.random.default_rng(0).multinomial(_PARTS, [1 / _PARTS] * _PARTS, _RESAMPLINGS)
    steered, yaw = steered - steered.mean(axis=1, keepdims=True), yaw - yaw.mean()

    def drawn(values: Values) -> Values:
        """(lags or 1, drives): the sum of (lags or 1, N) in each."""
        return np.asarray(np.add.reduceat(np.atleast_2d(values), starts, axis=1) @ times.T)

    count, of_steered, of_yaw = drawn(np.ones(len(yaw))), drawn(steered), drawn(yaw)
    together = drawn(steered * yaw) - of_steered * of_yaw / count
    size = np.sqrt((drawn(steered**2) - of_steered**2 / count).clip(1e-9))
    best: NDArray[np.int64] = np.abs(together / size).argmax(axis=0)
    return best


def _correlations(steered: Values, yaw: Values) -> Values:
    """The correlation of each row of `steered` (lags, N) with `yaw` (N,); 0 if one of them does not vary."""
    steered, yaw = steered - steered.mean(axis=1, keepdims=True), yaw - yaw.mean()
    size = np.sqrt((steered**2).sum(axis=1) * (yaw**2).sum())
    correlation: Values = np.divide(steered @ yaw, size, out=np.zeros(len(steered)), where=size > 1e-9)
    return correlation
