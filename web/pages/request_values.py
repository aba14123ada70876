"""The values of a request: the fields of a form, and numbers in an address."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable
from urllib.parse import parse_qsl

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import ImmutableMultiDict
from starlette.requests import Request
from starlette.responses import Response

from common.errors import printable
from common.untrusted import whole_number
from web.errors import WebError, or_404

_FORM = "application/x-www-form-urlencoded"


Values = ImmutableMultiDict[str, str]
"""The fields of a form or an address. If a name comes several times, its last value counts."""


def on_form(answer: Callable[[Request, Values], Response]) -> Callable[[Request], Awaitable[Response]]:
    """The endpoint that calls `answer` with the fields of a form, on a thread."""

    async def endpoint(request: Request) -> Response:
        return await run_in_threadpool(answer, request, await _form_values(request))

    return endpoint


async def _form_values(request: Request) -> Values:
    """Raises WebError for a request without a form."""
    if request.headers.get("content-type", "").partition(";")[0] != _FORM:
        raise WebError(f"this address takes only forms ({_FORM})", 415)
    try:
        text = (await request.body()).decode("ascii")
        return Values(parse_qsl(text, keep_blank_values=True))
    except ValueError as error:
        raise WebError(f"not a form: {error}", 422) from None


def has_words(text: str, words: Iterable[str]) -> bool:
    """Whether these words contain all words of a text of the user, in any case."""
    lower = " ".join(words).casefold()
    return all(word in lower for word in text.casefold().split())


def number_in(request: Request, part: str) -> int:
    """The number in a part of a request's address. Raises WebError for anything else."""
    text = request.path_params[part]
    reason = f"{part}: expected a number in the address, not {printable(text[:20])!r}"
    return or_404(whole_number(text), reason)
