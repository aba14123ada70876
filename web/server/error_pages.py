"""Responses for errors: a page where a browser opens an address, JSON for a script and a part of a page."""

from __future__ import annotations

from http import HTTPStatus

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.types import Scope

from common import UserError
from common.errors import StoreError, printable
from common.output import safe_line
from web.errors import WebError, report_bug
from web.server.templates import PAGES, page


def error_answer(scope: Scope, error: WebError) -> Response:
    """The answer to a request that failed, with the reason."""
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
