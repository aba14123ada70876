"""The lag of a log's steering. It is measured when a command first needs it, and kept next to the log in
NAME.lag.json, for one content of the log. Version 0.3 noted it in the log itself.

Steering times speed is proportional to the car's yaw, and the far field of the pictures shows the yaw
(`recorder.seen.far_field`). In a correct recording, the car turns up to 0.4 s after the steering. Another lag
shows that labels or pictures were delayed. A person's reaction time is not part of this lag: the car follows the
hand, not the road.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, overload

import msgspec
import numpy as np
from numpy.typing import NDArray

from common import atomic_file
from common.errors import UserError
from common.location import Location, Url
from common.random_access import read_bytes
from common.untrusted import json_as
from recorder import topics
from recorder.log.findings import findings
from recorder.log.reader import Log
from recorder.rows.label_plan import goes_by_lag, machine_of
from recorder.rows.row_quality import States, Values, elapsed_s
from recorder.rows.steering_habits import LagFinding, SteeringLag

if TYPE_CHECKING:
    from recorder.seen.far_field import PictureLog

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
    from recorder.seen.far_field import FarField, rows_apart  # OpenCV

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
    from recorder.seen.far_field import WIDTH_PX

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


_MAX_BYTES: Final = 1 << 16


class _Kept(msgspec.Struct):
    format: Literal[1]
    log: str  # its fingerprint
    lag: SteeringLag | None


@overload
def lag_path(log: Path) -> Path: ...


@overload
def lag_path(log: Url) -> Url: ...


def lag_path(log: Location) -> Location:
    return log.with_name(f"{log.name.removesuffix('.mcap')}.lag.json")


def driven_by(log: Log) -> str:
    """The machine that drove a log's session (`machine_of`)."""
    return machine_of(log.metadata, has_commands=bool(log.counts.get(topics.PILOT_COMMAND)))


def known_lag(log: Log) -> tuple[LagFinding | None, bool]:
    """The lag of a log's steering, from the log or the file next to it, and True if labels depend on it. None if
    it was never measured. Raises LogError for a damaged log; StoreError."""
    found = findings(log)
    needed = found is not None and goes_by_lag(found.steering, driven_by(log))
    noted = found.lag if found else None
    return noted or (kept_lag(log) if needed else None), needed


def lacks_lag(log: Log) -> bool:
    """True if a log's labels depend on the lag of its steering, but it was never measured."""
    lag, is_needed = known_lag(log)
    return lag is None and is_needed


def find_lag(log: Log) -> LagFinding | None:
    """The lag of a log's steering, measured in its pictures if unknown, and kept next to it; None if labels do not
    depend on it. Raises LogError for unreadable rows; StoreError."""
    lag, is_needed = known_lag(log)
    if lag is not None or not is_needed:
        return lag
    lag = LagFinding(measure_lag(log, States.of(log.vehicle())))
    if log.path.suffix == ".mcap":  # otherwise unfinished: its lag will be measured again
        _keep(lag_path(log.path), msgspec.json.encode(_Kept(1, log.fingerprint, lag.lag)) + b"\n")
    return lag


def kept_lag(log: Log) -> LagFinding | None:
    """The lag in the file next to a log, for its present content; None without one, or if the file is damaged."""
    data = _read(lag_path(log.path))
    kept = json_as(data, _Kept) if data else None
    return LagFinding(kept.lag) if kept is not None and kept.log == log.fingerprint else None


def _read(path: Location) -> bytes | None:
    if isinstance(path, Url) or (path.is_file() and not path.is_symlink()):
        with contextlib.suppress(OSError):
            return read_bytes(path, _MAX_BYTES)
    return None


def copy_lag(log: Location, to: Location) -> None:
    """Copy the lag next to a log to the log's copy, measured first on this machine: in a store, each picture costs
    a request. If that fails, it will be measured again there."""
    if isinstance(log, Path):
        with contextlib.suppress(Exception), Log(log) as opened:  # OpenCV may fail on untrusted pictures
            find_lag(opened)
    with contextlib.suppress(UserError):
        data = _read(lag_path(log))
        if data is not None and _read(lag_path(to)) != data:
            _keep(lag_path(to), data)


def _keep(path: Location, data: bytes) -> None:
    """Keep a lag; if it cannot be written, it will be measured again."""
    with contextlib.suppress(OSError, UserError):
        if isinstance(path, Url):
            from common.object_store import put_over  # an extra

            put_over(path, data)
        else:
            with atomic_file(path, overwrite=True) as part:
                part.write_bytes(data)
