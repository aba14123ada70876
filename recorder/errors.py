"""The recorder's errors: of logs, of recordings, and of the port for telemetry."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Iterator
from pathlib import Path

from common import UserError
from common.location import Location


class LogError(UserError):
    """A log that is missing, damaged, unfinished, or another program's."""


class RecordingError(UserError):
    """A recording that cannot be imported."""


class ListenError(UserError):
    """An address or a port that cannot be listened on."""


@contextlib.contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn an OSError into a RecordingError of one line."""
    try:
        yield
    except OSError as error:
        raise RecordingError(f"{error.filename or path}: cannot be read ({error.strerror})") from None


def damaged_pictures(log: Location) -> str:
    """The reason for skipped pictures in damaged chunks of a log."""
    return f"pictures in damaged chunks of {log} ({recovery(log)} saves the others)"


def recovery(log: Location) -> str:
    """The command that recovers a log, in backquotes."""
    return f"`bc-log recover {shlex.quote(str(log))}`"
