"""The values of a request: the fields of a form, and numbers in an address."""

from __future__ import annotations

from urllib.parse import parse_qsl

from starlette.requests import Request

from common.errors import printable
from common.whole_number import whole_number
from web.errors import WebError

_FORM = "application/x-www-form-urlencoded"
_MOST = 2000  # a thousand logs may be merged


async def form_values(request: Request) -> dict[str, str]:
    """The fields of a form. Raises WebError for a request without one."""
    return dict(await form_pairs(request))


async def form_pairs(request: Request) -> list[tuple[str, str]]:
    """The same, where a name may have several values."""
    if request.headers.get("content-type", "").partition(";")[0] != _FORM:
        raise WebError(f"this address takes only forms ({_FORM})", 415)
    try:
        return parse_qsl((await request.body()).decode("ascii"), keep_blank_values=True, max_num_fields=_MOST)
    except ValueError as error:
        raise WebError(f"not a form: {error}", 422) from None


def number_in(request: Request, part: str) -> int:
    """Return the number in that part of a request's address. Raises WebError for anything else."""
    text = request.path_params[part]
    number = whole_number(text)
    if number is None:
        raise WebError(f"{part}: a number was expected in the address, not {printable(text[:20])!r}", 404)
    return number
