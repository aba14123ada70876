"""The numbers in the addresses of pages."""

from __future__ import annotations

from starlette.requests import Request

from common.errors import printable
from common.whole_number import whole_number
from web.errors import WebError


def number_in(request: Request, part: str) -> int:
    """Return the number in that part of a request's address. Raises WebError for anything else."""
    text = request.path_params[part]
    number = whole_number(text)
    if number is None:
        raise WebError(f"{part}: a number was expected in the address, not {printable(text[:20])!r}", 404)
    return number
