"""The known lag of a log's steering. The log's writer notes the lag in the log; if it is measured later, it is
kept next to the log in NAME.lag.json, for one content of the log."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Final, Literal, overload

import msgspec

from common import atomic_file
from common.closeable import Closeable
from common.errors import UserError
from common.location import Location, Url
from common.random_access import LocalFile, read_bytes
from common.untrusted_json import json_as
from recorder import topics
from recorder.log.reader import Log
from recorder.mcap.message_index import UNCOMPRESSED
from recorder.mcap.picture_places import Pictures
from recorder.rows.steering_habits import LagFinding, SteeringLag

_KEY: Final = "lag"
_MAX_BYTES: Final = 1 << 16


class _Kept(msgspec.Struct):
    format: Literal[1]
    log: str  # its fingerprint
    lag: SteeringLag | None


def lag_note(finding: LagFinding) -> dict[str, str]:
    """The lag in a log's summary of its rows."""
    return {_KEY: json.dumps(finding.lag and asdict(finding.lag), allow_nan=False)}


def noted_lag(quality: Mapping[str, str]) -> LagFinding | None:
    """The lag from a log's summary of its rows; None if its writer did not measure it."""
    return json_as(f'{{"lag":{quality.get(_KEY, "")}}}', LagFinding)


@overload
def lag_path(log: Path) -> Path: ...


@overload
def lag_path(log: Url) -> Url: ...


def lag_path(log: Location) -> Location:
    return log.with_name(f"{log.name.removesuffix('.mcap')}.lag.json")


def known_lag(log: Log) -> LagFinding | None:
    """The lag of a log's steering; None if it was never measured. Raises StoreError."""
    return noted_lag(log.read_metadata(topics.QUALITY_METADATA)) or kept_lag(log)


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
    """Copy the lag next to a log to the log's copy. If that fails, it will be measured again there."""
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


class WrittenPictures(Closeable):
    """The centre camera's pictures of a log while it is written, read back from its file to measure the lag."""

    def __init__(self, part: Path, pictures: Pictures) -> None:
        """Raises OSError."""
        self._file = LocalFile(part)
        self._pictures = pictures

    def pictures(self, topic: str) -> Pictures:
        return self._pictures

    def read(self, offset: int, length: int, chunk: int = UNCOMPRESSED) -> bytes:
        return self._file.read(offset, length)

    def close(self) -> None:
        self._file.close()
