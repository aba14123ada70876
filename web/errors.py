"""Errors of the workbench that a page shows."""

from __future__ import annotations

from common import UserError


class WebError(UserError):
    """A request that cannot be answered, with the HTTP status that says so."""

    def __init__(self, text: str, status: int = 400) -> None:
        super().__init__(text)
        self.status = status
