"""Errors of the workbench that a page shows."""

from __future__ import annotations

import traceback

from common import UserError


class WebError(UserError):
    """A request that cannot be answered, with its HTTP status."""

    def __init__(self, text: str, status: int = 400) -> None:
        super().__init__(text)
        self.status = status


def report_bug(error: Exception, title: str = "a bug") -> str:
    """The line that a page shows for a bug of ours; its traceback goes to the terminal."""
    traceback.print_exception(error)
    return f"{title} ({type(error).__name__}); more is in the terminal of bc-web"
