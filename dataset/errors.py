"""The errors of the package `dataset`."""

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
    """The index is missing, empty, damaged, or older than its logs; or a picture cannot be decoded."""


class UnusablePictureError(DatasetError):
    """A picture cannot be decoded or read. Only this picture is left out. `kind` is the reason in `Skipped`."""

    def __init__(self, kind: str, why: str) -> None:
        super().__init__(why)
        self.kind = kind


class SessionError(LogError):
    """A session cannot be indexed, which showed only when its pictures were read."""

    def __init__(self, session: str, error: LogError) -> None:
        super().__init__(str(error))
        self.session = session


def log_problem(log: Location, error: Exception) -> LogError:
    """Convert any error while reading a log to a LogError, which leaves out only this log. Raises errors about the
    index or the store again."""
    if isinstance(error, UserError) and not isinstance(error, LogError):
        raise error
    return error if isinstance(error, LogError) else LogError(str(as_user_error(log, error)))


@contextlib.contextmanager
def index_write_errors(path: Path) -> Iterator[None]:
    """Raise an OSError of the block as a DatasetError that names `path`: pyarrow's errors name no file."""
    try:
        yield
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else " ".join(str(error).split())
        raise DatasetError(f"{path}: cannot be written ({reason})") from None
