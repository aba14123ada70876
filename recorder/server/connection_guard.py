"""Who else knocks at the port: each gets an answer it understands, and one line for a person says what to do.

A port is found by browsers, scanners and clients of every age.
"""

from __future__ import annotations

import contextlib
import math
import socket
import time
from collections.abc import Callable, Iterable
from typing import Any, Final

from recorder.server.engineio_connection import STREAM

Said = Callable[[str], None]

REQUEST_S: Final = 10.0
"""How long a request may take to come, all of it, and somebody who has connected to make one."""
MOST_CONNECTIONS: Final = 128
END_S: Final = 0.5
"""How long connections may take to end by themselves, their last commands sent, before they are cut."""

PAGE: Final = "This port is for driving simulators: start one in autonomous mode, and it connects by itself.\n"

BROWSER: Final = "somebody looks at this port with a browser: start the simulator's autonomous mode instead"
TLS: Final = "somebody connects by TLS, which is not spoken here: begin the address with ws:// or http://"
NO_HTTP: Final = "something that is no simulator sends bytes to this port: give one of the two another port"
SILENT: Final = f"hung up on somebody who said nothing for {REQUEST_S:g} s: a simulator speaks at once, start one"
SLOW: Final = f"hung up on somebody whose request took longer than {REQUEST_S:g} s: a simulator's comes at once"
CROWD: Final = f"{MOST_CONNECTIONS} connections at once: close some, further ones are not served"

_METHODS: Final = (
    b"GET ",
    b"POST ",
    b"HEAD ",
    b"OPTIONS ",
    b"PUT ",
    b"DELETE ",
    b"PATCH ",
    b"CONNECT ",
    b"TRACE ",
)
_TLS_HELLO: Final = b"\x16\x03"


class Visits:
    """The connections that are served, and until when the requests of some have to be there."""

    def __init__(self, said: Said) -> None:
        self._said = said
        self._due_s: dict[Any, float] = {}  # time.monotonic(); infinite before a request and after it

    def __len__(self) -> int:
        return len(self._due_s)

    def begin(self, stream: Any) -> None:
        self._due_s[stream] = math.inf

    def request_begins(self, stream: Any) -> None:
        self._due_s[stream] = time.monotonic() + REQUEST_S

    def request_is_there(self, stream: Any) -> None:
        self._due_s[stream] = math.inf

    def end(self, stream: Any) -> None:
        self._due_s.pop(stream, None)

    def cut_late_ones(self) -> None:
        """To be called now and then: a timeout counts from byte to byte, and one byte now and then beats it."""
        now_s = time.monotonic()
        for stream, due_s in list(self._due_s.items()):
            if now_s > due_s:
                self._said(SLOW)
                _cut(stream)

    def cut(self) -> None:
        """End all of them, in whatever they are."""
        for stream in list(self._due_s):
            _cut(stream)


class Visitor:
    """Looks at a connection's first bytes before its request is read; mix it in before a web server's kind of
    `BaseHTTPRequestHandler` (eventlet has its own copy of that)."""

    connection: socket.socket

    def __init__(self, *arguments: Any, said: Said, visits: Visits) -> None:
        """The connection is among `visits` while it is served."""
        self._said = said
        self._visits = visits
        super().__init__(*arguments)  # handles the request

    def handle(self) -> None:
        self._visits.begin(self.connection)
        try:
            problem = _problem(self.connection)
            if problem is None:
                self._visits.request_begins(self.connection)
                super().handle()  # type: ignore[misc]
            elif problem:
                self._said(problem)
        finally:
            self._visits.end(self.connection)

    def get_environ(self) -> dict[str, Any]:
        environ: dict[str, Any] = super().get_environ()  # type: ignore[misc]
        environ[STREAM] = self.connection
        if environ["REQUEST_METHOD"] == "GET":  # it has no body: the answer may take its time
            self._visits.request_is_there(self.connection)
        return environ

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        self._said(NO_HTTP)
        super().send_error(code, message, explain)  # type: ignore[misc]

    def log_message(self, format: str, *arguments: Any) -> None:
        pass  # what is worth a line is said


def page(said: Said) -> Callable[[dict[str, Any], Callable[..., Any]], Iterable[bytes]]:
    """A web application that tells whoever looks at the port what it is for."""

    def show(environ: dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
        said(BROWSER)
        text = PAGE.encode()
        headers = [("Content-Type", "text/plain; charset=utf-8"), ("Content-Length", str(len(text)))]
        start_response("200 OK" if environ.get("PATH_INFO") in ("", "/") else "404 Not Found", headers)
        return [text]

    return show


def _cut(stream: Any) -> None:
    with contextlib.suppress(OSError):
        stream.shutdown(socket.SHUT_RDWR)


def _problem(connection: socket.socket) -> str | None:
    """What is wrong with somebody who has connected: None if it begins a request, empty if it only left again."""
    connection.settimeout(REQUEST_S)
    try:
        first = connection.recv(8, socket.MSG_PEEK)
    except TimeoutError:
        return SILENT
    except (OSError, EOFError):  # the latter is eventlet's
        return ""
    if not first:
        return ""
    if first.startswith(_TLS_HELLO):
        return TLS
    if any(method.startswith(first) or first.startswith(method) for method in _METHODS):
        return None
    return NO_HTTP
