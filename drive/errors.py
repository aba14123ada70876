"""The error of drives."""

from __future__ import annotations

from common import UserError


class DriveError(UserError):
    """A drive cannot start, because its speed or its course is invalid, or its simulator has failed."""
