"""Guards the port: other programs, such as browsers and scanners, get a clear answer and time limits.

Each notice is one line with the next step.
"""

from __future__ import annotations

import contextlib
import math
import socket
import time
from collections.abc import Callable, Iterable
from http import HTTPMethod
from typing import Any, Final

Notify = Callable[[str], None]

REQUEST_S: Final = 10.0  # the time limit for a whole request, and for the first byte of a new connection
MAX_CONNECTIONS: Final = 128
END_S: Final = 0.5  # the time connections have to end by themselves, their last commands sent, before they are cut

LANDING_PAGE: Final = (
    "This port is for driving simulators: start one in autonomous mode, and it connects by itself.\n"
)

NOTICE_BROWSER: Final = "a browser has opened this port: start the simulator's autonomous mode instead"
NOTICE_TLS: Final = "a client uses TLS, which this port does not support: begin the address with ws:// or http://"
NOTICE_NOT_HTTP: Final = (
    "a client sent no whole HTTP request: if it is another program, give one of the two another port"
)
NOTICE_SILENT: Final = (
    f"disconnected a client that sent nothing for {REQUEST_S:g} s: a simulator sends at once, start one"
)
NOTICE_SLOW: Final = (
    f"disconnected a client whose request took longer than {REQUEST_S:g} s: a simulator's comes at once"
)
NOTICE_TOO_MANY: Final = f"{MAX_CONNECTIONS} connections at once: close some, further ones are not served"

_METHODS: Final = tuple(f"{method} ".encode() for method in HTTPMethod)
_TLS_HELLO: Final = b"\x16\x03"


class OpenConnections:
    """The open connections, and the deadlines of those without a complete request."""

    def __init__(self, notify: Notify) -> None:
        self._notify = notify
        self._deadlines_s: dict[Any, float] = {}  # time.monotonic(); infinite before a request and after it

    def add(self, stream: Any, limit_s: float = math.inf) -> None:
        """Add a connection, or change its time limit: `REQUEST_S` for a request, none before it and after it."""
        self._deadlines_s[stream] = time.monotonic() + limit_s

    def remove(self, stream: Any) -> None:
        self._deadlines_s.pop(stream, None)

    def close_overdue(self) -> None:
        """Cut the connections whose request is late. Call it regularly.

        A socket's timeout counts from byte to byte: a client that sends a byte now and then never reaches it.
        """
        now_s = time.monotonic()
        for stream, deadline_s in list(self._deadlines_s.items()):
            if now_s > deadline_s:
                self._notify(NOTICE_SLOW)
                _shut_down(stream)

    def close_all(self) -> None:
        """Cut all connections at once."""
        for stream in list(self._deadlines_s):
            _shut_down(stream)


def landing_page(notify: Notify) -> Callable[[dict[str, Any], Callable[..., Any]], Iterable[bytes]]:
    """A web application that explains the port to a browser."""

    def show(environ: dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
        notify(NOTICE_BROWSER)
        text = LANDING_PAGE.encode()
        headers = [("Content-Type", "text/plain; charset=utf-8"), ("Content-Length", str(len(text)))]
        start_response("200 OK" if environ.get("PATH_INFO") in ("", "/") else "404 Not Found", headers)
        return [text]

    return show


def _shut_down(stream: Any) -> None:
    with contextlib.suppress(OSError):
        stream.shutdown(socket.SHUT_RDWR)


def first_bytes_problem(connection: socket.socket) -> str | None:
    """The notice about a connection that does not begin with an HTTP request. None if it does; empty if the client
    has left."""
    connection.settimeout(REQUEST_S)
    try:
        first = connection.recv(8, socket.MSG_PEEK)
    except TimeoutError:
        return NOTICE_SILENT
    except (OSError, EOFError):  # the latter is eventlet's
        return ""
    if not first:
        return ""
    if first.startswith(_TLS_HELLO):
        return NOTICE_TLS
    if any(method.startswith(first) or first.startswith(method) for method in _METHODS):
        return None
    return NOTICE_NOT_HTTP
