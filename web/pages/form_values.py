"""The values of a form that was sent."""

from __future__ import annotations

from urllib.parse import parse_qsl

from starlette.requests import Request

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
