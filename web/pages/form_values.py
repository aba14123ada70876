"""The values of a form that was sent."""

from __future__ import annotations

from urllib.parse import parse_qsl

from starlette.requests import Request

from web.errors import WebError

_FORM = "application/x-www-form-urlencoded"


async def form_values(request: Request) -> dict[str, str]:
    """Raises WebError for what is no form."""
    if request.headers.get("content-type", "").partition(";")[0] != _FORM:
        raise WebError(f"this is asked for by a form ({_FORM})", 415)
    try:
        pairs = parse_qsl((await request.body()).decode("ascii"), keep_blank_values=True, max_num_fields=100)
    except ValueError as error:
        raise WebError(f"not a form: {error}", 422) from None
    return dict(pairs)
