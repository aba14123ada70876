"""What can keep a drive from starting."""

from __future__ import annotations

from common import UserError


class DriveError(UserError):
    """A server that cannot start: its port is taken, its host is not this machine's."""
