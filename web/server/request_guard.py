"""Access control: the check of each request's Host, Origin and token, and the headers of each response.

A page of another site, open in the same browser, can send requests to this machine. Its `Host` is not one of ours
(DNS rebinding) or its `Origin` not that of our own pages; `Sec-Fetch-Site` shows it for requests without an Origin
(https://www.w3.org/TR/fetch-metadata/). Programs that are no browsers send neither, and need not be kept out: they
can read the files themselves. A websocket steers a car: it needs an Origin, which only our own pages have rightly.
Where others can reach the port, everything needs the token that was printed.
"""

from __future__ import annotations

import hmac
import secrets
from http.cookies import CookieError, SimpleCookie
from typing import Final
from urllib.parse import parse_qsl, quote, urlencode

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from common.whole_number import whole_number
from recorder.server.allowed_hosts import AllowedHosts, is_loopback
from web.errors import WebError
from web.folders.uploads import MAX_UPLOAD_BYTES
from web.server.error_pages import error_answer

TOKEN: Final = "token"
_COOKIE: Final = "bc-web-token"
MAX_BODY_BYTES: Final = 1 << 20
UPLOAD: Final = "/import.upload"
"""The address that takes more: a recording."""

CONTENT_SECURITY_POLICY: Final = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' blob:",
        "connect-src 'self'",
        "frame-src 'self'",
        "form-action 'self'",
        "base-uri 'none'",
        "frame-ancestors 'none'",
    )
)
_HEADERS: Final = {
    "Content-Security-Policy": CONTENT_SECURITY_POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
# browsers heed it on this machine's own addresses; on others that are not encrypted, it is an error to them
_HEADERS_HERE: Final = {"Cross-Origin-Opener-Policy": "same-origin"}


def token_for(host: str) -> str:
    """A new token where others can reach the server; empty on this machine's own addresses."""
    return "" if is_loopback(host) else secrets.token_urlsafe(24)


class RequestGuard:
    """ASGI middleware around all that is served."""

    def __init__(self, app: ASGIApp, host: str, token: str) -> None:
        """`token`: empty where none is needed."""
        self._app = app
        self._hosts = AllowedHosts(host)
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            return  # nothing else is served, and the server is not asked for it
        answer: ASGIApp = self._app
        try:
            self._check_origin(scope)
            if self._token:
                answer = self._check_token(scope) or self._app
            _check_size(scope)
        except WebError as error:
            if scope["type"] == "websocket":  # uvicorn reports a refusal that has a text as a bug of ours
                await send({"type": "websocket.close"})
                return
            answer = error_answer(scope, error)

        is_begun = False

        async def send_with_headers(message: Message) -> None:
            nonlocal is_begun
            if message["type"] == "http.response.start":
                is_begun = True
                headers = MutableHeaders(scope=message)
                for name, value in (_HEADERS if self._token else {**_HEADERS, **_HEADERS_HERE}).items():
                    headers.setdefault(name, value)
                headers.setdefault("Cache-Control", "no-store")
            await send(message)

        try:
            await answer(scope, receive, send_with_headers)
        except Exception:
            if not is_begun:  # else it is a bug that was answered and printed, which Starlette raises once more
                raise

    def _check_origin(self, scope: Scope) -> None:
        headers = Headers(scope=scope)
        host, origin = headers.get("host"), headers.get("origin")
        environ = {"HTTP_HOST": host} if host is not None else {}
        if why := self._hosts.why_refused(environ):
            raise WebError(f"asked {why}: this workbench answers to its own address only", 403)
        own = {f"{scheme}://{host}".lower() for scheme in ("http", "https")}  # https: by a proxy in front of it
        if origin is not None and origin.lower() not in own:
            raise WebError(f"asked by a page from {origin}: only the workbench's own pages may ask", 403)
        if origin is None and scope["type"] == "websocket":  # a browser sends one with each
            raise WebError("a websocket without an Origin: only the workbench's own pages may ask", 403)
        site, mode = headers.get("sec-fetch-site"), headers.get("sec-fetch-mode")
        is_get = scope.get("method") == "GET"
        is_opened = mode == "navigate" and is_get and headers.get("sec-fetch-dest") == "document"
        if site not in (None, "same-origin", "none") and not is_opened:
            raise WebError("asked by a page of another site: only the workbench's own pages may ask", 403)

    def _check_token(self, scope: Scope) -> ASGIApp | None:
        """A request with the token in its address gets a cookie, and is redirected to the address without it."""
        headers = Headers(scope=scope)
        given = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        in_address = next((value for name, value in given if name == TOKEN), "")
        if in_address and self._is_token(in_address) and scope["type"] == "http":
            rest = urlencode([(name, value) for name, value in given if name != TOKEN])
            # one slash: two would be the address of another server
            path = "/" + quote(scope["path"]).lstrip("/")
            answer = RedirectResponse(f"{path}?{rest}" if rest else path, status_code=303)
            answer.set_cookie(_COOKIE, self._token, httponly=True, samesite="lax")
            return answer
        scheme, _, bearer = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer" and self._is_token(bearer.strip()):
            return None
        if self._is_token(_cookie(headers)):
            return None
        raise WebError("this workbench needs its token: open the address that bc-web printed when it began", 401)

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self._token.encode())


def _cookie(headers: Headers) -> str:
    try:
        cookies = SimpleCookie(headers.get("cookie", ""))
    except CookieError:
        return ""
    return cookies[_COOKIE].value if _COOKIE in cookies else ""


def _check_size(scope: Scope) -> None:
    """Refuse a body that is too long, or has no length, which no client of ours sends."""
    if scope["type"] == "websocket" or scope["method"] in ("GET", "HEAD"):
        return  # the server limits the messages of a websocket
    length = whole_number(Headers(scope=scope).get("content-length", ""))
    if length is None:
        raise WebError("a request with a body needs its length (Content-Length)", 411)
    most = MAX_UPLOAD_BYTES if scope["path"] == UPLOAD else MAX_BODY_BYTES
    if length > most:
        raise WebError(f"a request of {length:,} bytes: at most {most:,} are taken", 413)
