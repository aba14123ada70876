"""Errors of the workbench that a page shows."""

from __future__ import annotations

import traceback

from common import UserError


class WebError(UserError):
    """A request that cannot be answered, with the HTTP status that says so."""

    def __init__(self, text: str, status: int = 400) -> None:
        super().__init__(text)
        self.status = status


def tell_bug(error: Exception, what: str = "a bug") -> str:
    """What a page says of a mistake of ours; its traceback goes to the terminal."""
    traceback.print_exception(error)
    return f"{what} ({type(error).__name__}); the terminal of bc-web tells more"
