"""Errors that pages show."""

from __future__ import annotations

import traceback
from typing import TypeVar

from common import UserError

Value = TypeVar("Value")


class WebError(UserError):
    """Why a request failed, and the HTTP status."""

    def __init__(self, text: str, status: int = 400) -> None:
        super().__init__(text)
        self.status = status


def or_404(value: Value | None, reason: str) -> Value:
    """The value. Raises WebError for None: what a request names does not exist (any more)."""
    if value is None:
        raise WebError(reason, 404)
    return value


def report_bug(error: Exception, title: str = "a bug") -> str:
    """Print the traceback of a bug. Return the line for the page."""
    traceback.print_exception(error)
    return f"{title} ({type(error).__name__}); details are in the terminal of bc-web"
