"""What can be wrong with a log or a recording."""

from __future__ import annotations

from common import UserError


class LogError(UserError):
    """A log that is missing, damaged, unfinished, or of another program."""


class RecordingError(UserError):
    """A recording that cannot be imported."""
