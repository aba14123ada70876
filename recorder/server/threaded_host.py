"""The standard library's web server: each connection is served in a thread of its own."""

from __future__ import annotations

import functools
import io
import socketserver
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

from recorder.server.connection_guard import (
    END_S,
    MAX_CONNECTIONS,
    NOTICE_TOO_MANY,
    GuardedHandler,
    Notify,
    OpenConnections,
)
from recorder.server.engineio_connection import Lock
from recorder.server.listening_socket import QuickAckSocket, listen


class _Handler(GuardedHandler, WSGIRequestHandler):
    def get_stderr(self) -> io.StringIO:
        return io.StringIO()  # for the tracebacks of clients that have gone


class ThreadedHost(socketserver.ThreadingMixIn, WSGIServer):
    """Connections are accepted by the thread that runs the server, while it waits for its next tick."""

    def __init__(self, host: str, port: int, notify: Notify) -> None:
        """Starts to listen. Raises ListenError if that is not possible."""
        listener: QuickAckSocket = listen(host, port, QuickAckSocket)
        self._notify = notify
        self._open_connections = OpenConnections(notify)
        handler: Any = functools.partial(_Handler, notify=notify, open_connections=self._open_connections)
        # Not TCPServer's, which opens a socket of its own, nor HTTPServer's, which asks for the host's full name.
        socketserver.BaseServer.__init__(self, listener.getsockname(), handler)
        self.socket = listener
        self.server_name, self.server_port = listener.getsockname()[:2]
        self.port: int = self.server_port
        self.setup_environ()

    def make_lock(self) -> Lock:
        return threading.Lock()

    def let_others_run(self) -> None:
        pass  # the system switches threads by itself

    def start(self, application: Callable[..., Iterable[bytes]]) -> None:
        self.set_app(application)

    def wait(self, seconds: float) -> None:
        until_s = time.monotonic() + seconds
        while (left_s := until_s - time.monotonic()) > 0:
            self.timeout = left_s
            self.handle_request()
        self._open_connections.close_overdue()

    def after_websocket(self) -> Iterable[bytes]:
        raise ConnectionAbortedError  # then nothing more is written, and nothing logged

    def end(self) -> None:
        until_s = time.monotonic() + END_S
        while len(self._open_connections) and time.monotonic() < until_s:
            time.sleep(0.01)
        self._open_connections.close_all()
        self.close()

    def close(self) -> None:
        self.server_close()

    def verify_request(self, request: Any, client_address: Any) -> bool:
        if len(self._open_connections) < MAX_CONNECTIONS:
            return True
        self._notify(NOTICE_TOO_MANY)
        return False

    def process_request(self, request: Any, client_address: Any) -> None:
        self._open_connections.add(request)  # before its thread does: the server may end first
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        super().shutdown_request(request)
        self._open_connections.remove(request)  # also where it got no thread

    def handle_error(self, request: Any, client_address: Any) -> None:
        pass  # the client has gone; the application's own errors never get here
