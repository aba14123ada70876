"""The web server of eventlet: each connection is served in a green thread."""

from __future__ import annotations

import contextlib
import functools
import os
import socket
import warnings
from collections.abc import Callable, Iterable
from typing import Any, Final

from recorder.server.connection_guard import (
    END_S,
    MAX_CONNECTIONS,
    NOTICE_NOT_HTTP,
    NOTICE_TOO_MANY,
    REQUEST_S,
    Notify,
    OpenConnections,
    first_bytes_problem,
    listen,
    send_at_once,
)
from recorder.server.websocket import WebSocket

with warnings.catch_warnings():
    # users can do nothing about this warning
    warnings.filterwarnings("ignore", message=r"\s*Eventlet is deprecated")
    # eventlet's own resolver is not needed, and takes a quarter of the loading time
    os.environ.setdefault("EVENTLET_NO_GREENDNS", "yes")
    import eventlet
    import eventlet.greenio
    import eventlet.semaphore
    import eventlet.wsgi

_HANDSHAKE: Final = ("Host", "Upgrade", "Connection", "Sec-WebSocket-Key", "Sec-WebSocket-Version")


def let_others_run() -> None:
    eventlet.sleep(0)


def open_websocket(environ: dict[str, Any], *, max_bytes: int, timeout_s: float) -> WebSocket:
    """Make a request's connection a websocket. Raises HandshakeError, or OSError if the client has gone."""
    values = {name: environ.get("HTTP_" + name.upper().replace("-", "_")) for name in _HANDSHAKE}
    stream = environ["eventlet.input"].get_socket()
    stream.settimeout(timeout_s)
    websocket = WebSocket(
        stream,
        [(name, value) for name, value in values.items() if value is not None],
        max_bytes=max_bytes,
        lock=eventlet.semaphore.Semaphore(),
        let_others_run=let_others_run,
    )
    eventlet.wsgi.WSGI_LOCAL.already_handled = True  # no HTTP answer follows
    return websocket


class QuickAckGreenSocket(eventlet.greenio.GreenSocket):  # type: ignore[misc]
    """A socket of eventlet that acknowledges received data at once, as do its accepted connections.

    The real simulator sends a telemetry in many small writes, with Nagle's algorithm on. Each write waits for the
    previous acknowledgement, which Linux delays. Measured: 44 ms a telemetry with the delay, 0.6 without.
    """

    def recv(self, *arguments: Any, **options: Any) -> bytes:
        data: bytes = super().recv(*arguments, **options)
        if hasattr(socket, "TCP_QUICKACK"):  # Linux; the kernel switches it off again by itself
            self.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        return data

    def accept(self) -> tuple[QuickAckGreenSocket, Any]:
        connection, address = super().accept()
        send_at_once(connection)
        return connection, address


class _Handler(eventlet.wsgi.HttpProtocol):  # type: ignore[misc]
    """Checks a connection's first bytes before it reads a request."""

    def __init__(self, *arguments: Any, notify: Notify, open_connections: OpenConnections) -> None:
        """`open_connections` has the connection while it is served."""
        self._notify = notify
        self._open_connections = open_connections
        super().__init__(*arguments)  # also handles the request

    def handle(self) -> None:
        self._open_connections.add(self.connection)
        try:
            problem = first_bytes_problem(self.connection)
            if problem is None:
                self._open_connections.add(self.connection, REQUEST_S)
                super().handle()
            elif problem:
                self._notify(problem)
        finally:
            self._open_connections.remove(self.connection)

    def get_environ(self) -> dict[str, Any]:
        environ: dict[str, Any] = super().get_environ()
        if environ["REQUEST_METHOD"] == "GET":  # a request without a body is complete
            self._open_connections.add(self.connection)
        return environ

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        self._notify(NOTICE_NOT_HTTP)
        super().send_error(code, message, explain)

    def log_message(self, format: str, *arguments: Any) -> None:
        pass  # notices are enough

    def finish(self) -> None:
        try:
            super().finish()
        finally:  # if the client has gone, eventlet leaves both open, and with them the connection
            for stream in (self.wfile, self.rfile):
                with contextlib.suppress(OSError):
                    stream.close()


class EventletHost:
    """Serves connections while the server's thread waits for its next tick."""

    def __init__(self, host: str, port: int, notify: Notify) -> None:
        """Starts to listen. Raises ListenError if that fails."""
        self._listener: QuickAckGreenSocket = listen(host, port, QuickAckGreenSocket)
        self.port: int = self._listener.getsockname()[1]
        self._notify = notify
        self._open_connections = OpenConnections(notify)
        self._connections = eventlet.GreenPool(MAX_CONNECTIONS)

    def start(self, application: Callable[..., Iterable[bytes]]) -> None:
        self._web = eventlet.spawn(
            eventlet.wsgi.server,
            self._listener,
            application,
            environ={"wsgi.errors": eventlet.wsgi.LoggerNull()},
            protocol=functools.partial(_Handler, notify=self._notify, open_connections=self._open_connections),
            custom_pool=self._connections,
            keepalive=False,
            socket_timeout=REQUEST_S,
            log_output=False,
            debug=False,  # sends no tracebacks to clients
        )

    def wait(self, seconds: float) -> None:
        eventlet.sleep(seconds)
        self._open_connections.close_overdue()
        if not self._connections.free():
            self._notify(NOTICE_TOO_MANY)

    def end(self) -> None:
        """Wait until closed connections have ended, and cut the others."""
        self._web.kill()
        for _ in range(2):
            with eventlet.Timeout(END_S, False):
                self._connections.waitall()
            self._open_connections.close_all()
        self.close()

    def close(self) -> None:
        self._listener.close()
