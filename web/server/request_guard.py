"""Access control: the check of each request's Host, Origin and token, and the headers of each response;
responses for errors: a page for a browser's address, JSON for a script or a part of a page.

Every program on this machine can send requests to its ports, also those of other users. So each request needs the
token, which is new at each start. bc-web prints an address with the token; opening it sets a cookie. A token that
outlives its server would be lost to the next program that listens on the port: open pages send their cookie to it.

A page of another site in the same browser can send requests to this machine, too. Its `Host` is foreign (DNS
rebinding), or its `Origin` is, or `Sec-Fetch-Site` shows the other site (https://www.w3.org/TR/fetch-metadata/). A
link of another site opens no page: opening a page starts work. A websocket steers a car, so it always needs our
Origin.
"""

from __future__ import annotations

import hmac
import re
import secrets
from http import HTTPStatus
from typing import Final
from urllib.parse import parse_qsl, quote, urlencode

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request, cookie_parser
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from common import UserError
from common.errors import StoreError, printable
from common.output import safe_line
from common.untrusted import whole_number
from recorder.server.connection_guard import AllowedHosts, is_loopback
from web.errors import WebError, report_bug
from web.folders.uploads import MAX_UPLOAD_BYTES
from web.server.templates import PAGES, STATIC, page


def error_answer(scope: Scope, error: WebError) -> Response:
    reason = printable(safe_line(str(error)))
    headers = Headers(scope=scope)
    if "text/html" in headers.get("accept", "") and "hx-request" not in headers:
        way_out = next((entry for entry in PAGES if scope["path"].startswith(entry[1])), PAGES[1])
        answer = page("error.html", title=HTTPStatus(error.status).phrase, reason=reason, way_out=way_out)
        answer.status_code = error.status
        return answer
    return JSONResponse({"error": reason}, status_code=error.status)


def on_user_error(request: Request, error: Exception) -> Response:
    """A wrong file, name or value."""
    if not isinstance(error, WebError):
        error = WebError(str(error), 503 if isinstance(error, StoreError) else 422)
    return error_answer(request.scope, error)


def on_http_error(request: Request, error: Exception) -> Response:
    """An unknown address, or a wrong method."""
    status = error.status_code if isinstance(error, HTTPException) else 500
    path = request.url.path
    reasons = {404: f"{path}: there is no such page", 405: f"{path}: the method {request.method} is not allowed"}
    return error_answer(request.scope, WebError(reasons.get(status, HTTPStatus(status).phrase), status))


def on_os_error(request: Request, error: Exception) -> Response:
    """An error of the operating system, such as a full disk."""
    reason = getattr(error, "strerror", None) or str(error)
    file = f"{error.filename}: " if isinstance(error, OSError) and error.filename is not None else ""
    return error_answer(request.scope, WebError(f"{file}{reason}", 500))


def on_bug(request: Request, error: Exception) -> Response:
    """Any other error is a bug. Its traceback is on the command's stderr."""
    return error_answer(request.scope, WebError(report_bug(error, "a bug of the workbench"), 500))


def on_disconnect(request: Request, error: Exception) -> Response:
    """The client has left before its request had arrived: nobody reads the answer."""
    return Response(status_code=400)


HANDLERS = {
    UserError: on_user_error,
    HTTPException: on_http_error,
    ClientDisconnect: on_disconnect,
    OSError: on_os_error,
    Exception: on_bug,
}


TOKEN: Final = "token"
MAX_BODY_BYTES: Final = 1 << 20
UPLOAD: Final = "/import.upload"
"""The address that takes recordings, which may be larger."""

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
# browsers report this header as an error on unencrypted addresses of other machines
_LOCAL_HEADERS: Final = {"Cross-Origin-Opener-Policy": "same-origin"}


def new_token() -> str:
    return secrets.token_urlsafe(24)


class RequestGuard:
    """ASGI middleware around the whole app."""

    def __init__(self, app: ASGIApp, host: str, token: str, once: str = "") -> None:
        """`token` is "" if requests need none. `once` opens the workbench in place of the token, but only once: a
        browser gets it in its command line, which other users of this machine can see."""
        self._app = app
        self._hosts = AllowedHosts(host)
        self._token = token
        self._once = once
        self._is_opened = False  # by `once`
        self._headers = {**_HEADERS, **_LOCAL_HEADERS} if is_loopback(host) else _HEADERS

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            return
        answer: ASGIApp = self._app
        try:
            self._check_origin(scope)
            if (entry := self._entry(scope)) is not None:
                answer = entry
            else:
                _check_site(scope)
                self._check_token(scope)
                _check_size(scope)
        except WebError as error:
            if scope["type"] == "websocket":  # uvicorn reports a refusal with a text as a bug
                await send({"type": "websocket.close"})
                return
            answer = error_answer(scope, error)

        is_begun = False

        async def send_with_headers(message: Message) -> None:
            nonlocal is_begun
            if message["type"] == "http.response.start":
                is_begun = True
                headers = MutableHeaders(scope=message)
                for name, value in self._headers.items():
                    headers.setdefault(name, value)
                headers.setdefault("Cache-Control", "no-store")
            await send(message)

        try:
            await answer(scope, receive, send_with_headers)
        except Exception:
            if not is_begun:  # Starlette raises a bug again after it is answered and printed
                raise

    def _check_origin(self, scope: Scope) -> None:
        headers = Headers(scope=scope)
        host, origin = headers.get("host"), headers.get("origin")
        environ = {"HTTP_HOST": host} if host is not None else {}
        if reason := self._hosts.why_refused(environ):
            raise WebError(f"a request {reason} is refused: open the address that bc-web printed", 403)
        own = {f"{scheme}://{host}".lower() for scheme in ("http", "https")}  # https: a proxy may encrypt
        if origin is not None and origin.lower() not in own:
            raise WebError(
                f"a request by a page from {origin}: only the workbench's own pages may send requests", 403
            )
        if origin is None and scope["type"] == "websocket":  # a browser always sends one
            raise WebError("a websocket without an Origin: only the workbench's own pages may open one", 403)

    def _entry(self, scope: Scope) -> ASGIApp | None:
        """For an address with the token, the answer that sets the cookie and redirects to the address without the
        token."""
        query = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        given = next((value for name, value in query if name == TOKEN), "")
        if scope["type"] != "http" or not (self._is_token(given) or self._is_once(given)):
            return None
        rest = urlencode([(name, value) for name, value in query if name != TOKEN])
        # one slash, because two begin the address of another server
        path = "/" + quote(scope["path"]).lstrip("/")
        answer = RedirectResponse(f"{path}?{rest}" if rest else path, status_code=303)
        answer.set_cookie(_cookie(scope), self._token, httponly=True, samesite="strict")
        return answer

    def _check_token(self, scope: Scope) -> None:
        """Raise WebError for a request without the token. Files of the pages need none: they are the toolkit's."""
        headers = Headers(scope=scope)
        if not self._token or scope["path"].startswith(f"{STATIC}/"):
            return
        scheme, _, bearer = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer" and self._is_token(bearer.strip()):
            return
        if not self._is_token(cookie_parser(headers.get("cookie", "")).get(_cookie(scope), "")):
            if self._is_opened and self._once in scope["query_string"].decode("latin-1"):
                raise WebError(
                    "this address opens bc-web only once, and it has been opened. If you did not open it, another"
                    " user of this machine did: end bc-web, and start it without --open",
                    401,
                )
            raise WebError(
                "this page needs the token of bc-web: open the address that bc-web printed, which ends with it;"
                " each start of bc-web has a new one",
                401,
            )

    def _is_token(self, text: str) -> bool:
        return bool(self._token) and hmac.compare_digest(text.encode(), self._token.encode())

    def _is_once(self, text: str) -> bool:
        if self._is_opened or not self._once or not hmac.compare_digest(text.encode(), self._once.encode()):
            return False
        self._is_opened = True
        return True


def _cookie(scope: Scope) -> str:
    """The name of the cookie. Browsers send the cookies of all ports of a host, so it has the port."""
    port = Headers(scope=scope).get("host", "").rpartition(":")[2]
    return f"bc-web-{port}" if re.fullmatch("[0-9]{1,5}", port) else "bc-web"


def _check_site(scope: Scope) -> None:
    """Raise WebError for what a page of another site requests, also by a link."""
    headers = Headers(scope=scope)
    if headers.get("sec-fetch-site") in (None, "same-origin", "none"):
        return
    if headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest") == "document":
        raise WebError("another site led here: for your safety, its link opens nothing; go on from here", 403)
    raise WebError("a request by a page of another site: only the workbench's own pages may send requests", 403)


def _check_size(scope: Scope) -> None:
    """Refuse a body that is too long, or has no length."""
    if scope["type"] == "websocket" or scope["method"] in ("GET", "HEAD"):
        return  # the server limits the messages of a websocket
    headers = Headers(scope=scope)
    length = whole_number(headers.get("content-length", ""))
    if length is None or "transfer-encoding" in headers:  # the server ignores the length of a body in chunks
        raise WebError("a request with a body needs its length (Content-Length), and no Transfer-Encoding", 411)
    limit = MAX_UPLOAD_BYTES if scope["path"] == UPLOAD else MAX_BODY_BYTES
    if length > limit:
        raise WebError(f"a request of {length:,} bytes: at most {limit:,} are allowed", 413)
