"""Serving each connection in a green thread, by eventlet's web server."""

from __future__ import annotations

import contextlib
import functools
import warnings
from collections.abc import Callable, Iterable
from typing import Any

from recorder.server.connection_guard import CROWD, END_S, MOST_CONNECTIONS, REQUEST_S, Said, Visitor, Visits
from recorder.server.engineio_connection import Lock
from recorder.server.listening_socket import QuickAck, listen, send_at_once

with warnings.catch_warnings():
    # The user asked for eventlet; whoever starts a drive can do nothing about the notice of its retirement.
    warnings.filterwarnings("ignore", message=r"\s*Eventlet is deprecated")
    import eventlet
    import eventlet.greenio
    import eventlet.semaphore
    import eventlet.wsgi


class GreenSocket(QuickAck, eventlet.greenio.GreenSocket):  # type: ignore[misc]
    """What it accepts is such a socket too."""

    def accept(self) -> tuple[GreenSocket, Any]:
        connection, address = super().accept()
        send_at_once(connection)
        return connection, address


class _Handler(Visitor, eventlet.wsgi.HttpProtocol):  # type: ignore[misc]
    def finish(self) -> None:
        try:
            super().finish()
        finally:  # eventlet leaves both open where the client has gone, and with them the connection
            for stream in (self.wfile, self.rfile):
                with contextlib.suppress(OSError):
                    stream.close()


class GreenHost:
    """Connections are served while the thread that runs the server waits for its next tick."""

    def __init__(self, host: str, port: int, said: Said) -> None:
        """Starts to listen. Raises ListenError if that is not possible."""
        self._listener: GreenSocket = listen(host, port, GreenSocket)
        self.port: int = self._listener.getsockname()[1]
        self._said = said
        self._visits = Visits(said)
        self._connections = eventlet.GreenPool(MOST_CONNECTIONS)

    def make_lock(self) -> Lock:
        lock: Lock = eventlet.semaphore.Semaphore()
        return lock

    def give_way(self) -> None:
        eventlet.sleep(0)

    def start(self, application: Callable[..., Iterable[bytes]]) -> None:
        self._web = eventlet.spawn(
            eventlet.wsgi.server,
            self._listener,
            application,
            environ={"wsgi.errors": eventlet.wsgi.LoggerNull()},
            protocol=functools.partial(_Handler, said=self._said, visits=self._visits),
            custom_pool=self._connections,
            keepalive=False,
            socket_timeout=REQUEST_S,
            log_output=False,
            debug=False,  # a client is not shown tracebacks
        )

    def wait(self, seconds: float) -> None:
        eventlet.sleep(seconds)
        self._visits.cut_late_ones()
        if not self._connections.free():
            self._said(CROWD)

    def after_websocket(self) -> Iterable[bytes]:
        eventlet.wsgi.WSGI_LOCAL.already_handled = True
        return []

    def end(self) -> None:
        self._web.kill()
        for _ in range(2):
            with eventlet.Timeout(END_S, False):
                self._connections.waitall()
            self._visits.cut()
        self._listener.close()
