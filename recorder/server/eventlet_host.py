"""The web server of eventlet: each connection is served in a green thread."""

from __future__ import annotations

import contextlib
import functools
import os
import warnings
from collections.abc import Callable, Iterable
from typing import Any

from recorder.server.connection_guard import (
    END_S,
    MAX_CONNECTIONS,
    NOTICE_TOO_MANY,
    REQUEST_S,
    GuardedHandler,
    Notify,
    OpenConnections,
)
from recorder.server.engineio_connection import Lock
from recorder.server.listening_socket import QuickAck, listen, send_at_once

with warnings.catch_warnings():
    # eventlet is needed here; the user of a drive can do nothing about the notice of its retirement.
    warnings.filterwarnings("ignore", message=r"\s*Eventlet is deprecated")
    # or it loads a resolver of its own, which takes a quarter of the time and is asked for nothing here
    os.environ.setdefault("EVENTLET_NO_GREENDNS", "yes")
    import eventlet
    import eventlet.greenio
    import eventlet.semaphore
    import eventlet.wsgi


class QuickAckGreenSocket(QuickAck, eventlet.greenio.GreenSocket):  # type: ignore[misc]
    """A socket of eventlet that acknowledges at once, and whose accepted connections do, too."""

    def accept(self) -> tuple[QuickAckGreenSocket, Any]:
        connection, address = super().accept()
        send_at_once(connection)
        return connection, address


class _Handler(GuardedHandler, eventlet.wsgi.HttpProtocol):  # type: ignore[misc]
    def finish(self) -> None:
        try:
            super().finish()
        finally:  # eventlet leaves both open where the client has gone, and with them the connection
            for stream in (self.wfile, self.rfile):
                with contextlib.suppress(OSError):
                    stream.close()


class EventletHost:
    """Connections are served while the thread that runs the server waits for its next tick."""

    def __init__(self, host: str, port: int, notify: Notify) -> None:
        """Starts to listen. Raises ListenError if that is not possible."""
        self._listener: QuickAckGreenSocket = listen(host, port, QuickAckGreenSocket)
        self.port: int = self._listener.getsockname()[1]
        self._notify = notify
        self._open_connections = OpenConnections(notify)
        self._connections = eventlet.GreenPool(MAX_CONNECTIONS)

    def make_lock(self) -> Lock:
        lock: Lock = eventlet.semaphore.Semaphore()
        return lock

    def let_others_run(self) -> None:
        eventlet.sleep(0)

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
            debug=False,  # a client is not shown tracebacks
        )

    def wait(self, seconds: float) -> None:
        eventlet.sleep(seconds)
        self._open_connections.close_overdue()
        if not self._connections.free():
            self._notify(NOTICE_TOO_MANY)

    def after_websocket(self) -> Iterable[bytes]:
        eventlet.wsgi.WSGI_LOCAL.already_handled = True
        return []

    def end(self) -> None:
        self._web.kill()
        for _ in range(2):
            with eventlet.Timeout(END_S, False):
                self._connections.waitall()
            self._open_connections.close_all()
        self.close()

    def close(self) -> None:
        self._listener.close()
