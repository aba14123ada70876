"""The error of a drive that cannot start."""

from __future__ import annotations

from common import UserError


class DriveError(UserError):
    """A drive that cannot start, because its speed or its course is nonsense; a simulator that failed."""
