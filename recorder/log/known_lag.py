"""The lag of a log's steering. It is measured when a command first needs it, and kept next to the log in
NAME.lag.json, for one content of the log. Version 0.3 noted it in the log itself."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Final, Literal, overload

import msgspec

from common import atomic_file
from common.errors import UserError
from common.location import Location, Url
from common.random_access import read_bytes
from common.untrusted import json_as
from recorder import topics
from recorder.log.findings import findings
from recorder.log.reader import Log
from recorder.rows.label_plan import goes_by_lag, machine_of
from recorder.rows.row_quality import States
from recorder.rows.steering_habits import LagFinding, SteeringLag

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


def find_lag(log: Log) -> tuple[LagFinding | None, bool]:
    """The lag of a log's steering, measured in its pictures if unknown; None if labels do not depend on it. The
    second value is False if the measured lag could not be kept. Raises LogError for unreadable rows;
    StoreError."""
    lag, is_needed = known_lag(log)
    if lag is not None or not is_needed:
        return lag, True
    from recorder.seen.steering_lag import measure_lag  # OpenCV

    lag = LagFinding(measure_lag(log, States.of(log.vehicle())))
    return lag, keep_lag(log, lag)


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


def keep_lag(log: Log, finding: LagFinding) -> bool:
    """Keep the lag next to a finished log; False if it cannot be written."""
    if log.path.suffix != ".mcap":
        return False  # an unfinished log: its lag will be measured again
    return _keep(lag_path(log.path), msgspec.json.encode(_Kept(1, log.fingerprint, finding.lag)) + b"\n")


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


def _keep(path: Location, data: bytes) -> bool:
    try:
        if isinstance(path, Url):
            from common.object_store import put_over  # an extra

            put_over(path, data)
        else:
            with atomic_file(path, overwrite=True) as part:
                part.write_bytes(data)
    except (OSError, UserError):
        return False
    return True
