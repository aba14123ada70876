"""Errors of runs."""

from __future__ import annotations

from common import UserError


class RunError(UserError):
    """A run that is missing, incomplete, damaged, of another version, or that cannot go on."""


class RunWriteError(RunError):
    """A file of a run that the system does not let be written: the disk is full, or not ours."""
