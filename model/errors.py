"""Errors of runs."""

from __future__ import annotations

from common import UserError


class RunError(UserError):
    """A run is missing, incomplete, damaged, of another version, or cannot continue."""


class RunWriteError(RunError):
    """A file of a run cannot be written: the disk is full, or permission is denied."""
