"""The errors of this room."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from common import UserError
from common.errors import as_user_error
from common.location import Location
from recorder.errors import LogError


class DatasetError(UserError):
    """An index that is missing, empty, damaged, or older than its logs; a picture that cannot be decoded."""


class PlaceNotAllowedError(DatasetError):
    """An index that names a log where its user has not put any: it is not opened."""


class UnusablePictureError(DatasetError):
    """A picture that cannot be shown: it is left out, and the others are not. `kind` is that of its reason."""

    def __init__(self, kind: str, why: str) -> None:
        super().__init__(why)
        self.kind = kind


class SessionError(LogError):
    """A session that cannot be indexed, found out only when its pictures were looked at."""

    def __init__(self, session: str, error: LogError) -> None:
        super().__init__(str(error))
        self.session = session


def log_problem(log: Location, error: Exception) -> LogError:
    """Whatever went wrong while a log was looked at, as an error that leaves this log out and no other. Raises
    those that are about something else: the index, a store."""
    if isinstance(error, UserError) and not isinstance(error, LogError):
        raise error
    return error if isinstance(error, LogError) else LogError(str(as_user_error(log, error)))


@contextlib.contextmanager
def index_write_errors(path: Path) -> Iterator[None]:
    """Raise DatasetError, which names `path`, for an OSError in the block: those of pyarrow name no file."""
    try:
        yield
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else " ".join(str(error).split())
        raise DatasetError(f"{path}: cannot be written ({reason})") from None
