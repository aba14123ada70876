"""Serving each connection in a thread of its own, by the standard library's web server."""

from __future__ import annotations

import functools
import io
import socketserver
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

from recorder.server.connection_guard import CROWD, END_S, MOST_CONNECTIONS, Said, Visitor, Visits
from recorder.server.engineio_connection import Lock
from recorder.server.listening_socket import QuickAckSocket, listen


class _Handler(Visitor, WSGIRequestHandler):
    def get_stderr(self) -> io.StringIO:
        return io.StringIO()  # for the tracebacks of clients that have gone


class ThreadedHost(socketserver.ThreadingMixIn, WSGIServer):
    """Connections are accepted by the thread that runs the server, while it waits for its next tick."""

    def __init__(self, host: str, port: int, said: Said) -> None:
        """Starts to listen. Raises ListenError if that is not possible."""
        listener: QuickAckSocket = listen(host, port, QuickAckSocket)
        self._said = said
        self._visits = Visits(said)
        handler: Any = functools.partial(_Handler, said=said, visits=self._visits)
        # Not TCPServer's, which opens a socket of its own, nor HTTPServer's, which asks for the host's full name.
        socketserver.BaseServer.__init__(self, listener.getsockname(), handler)
        self.socket = listener
        self.server_name, self.server_port = listener.getsockname()[:2]
        self.port: int = self.server_port
        self.setup_environ()

    def make_lock(self) -> Lock:
        return threading.Lock()

    def give_way(self) -> None:
        pass  # the system does not ask

    def start(self, application: Callable[..., Iterable[bytes]]) -> None:
        self.set_app(application)

    def wait(self, seconds: float) -> None:
        until_s = time.monotonic() + seconds
        while (left_s := until_s - time.monotonic()) > 0:
            self.timeout = left_s
            self.handle_request()
        self._visits.cut_late_ones()

    def after_websocket(self) -> Iterable[bytes]:
        raise ConnectionAbortedError  # nothing more is written then, nor said

    def end(self) -> None:
        until_s = time.monotonic() + END_S
        while len(self._visits) and time.monotonic() < until_s:
            time.sleep(0.01)
        self._visits.cut()
        self.server_close()

    def verify_request(self, request: Any, client_address: Any) -> bool:
        if len(self._visits) < MOST_CONNECTIONS:
            return True
        self._said(CROWD)
        return False

    def process_request(self, request: Any, client_address: Any) -> None:
        self._visits.begin(request)  # before its thread does: the server may end first
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        super().shutdown_request(request)
        self._visits.end(request)  # also where it got no thread

    def handle_error(self, request: Any, client_address: Any) -> None:
        pass  # the client has gone: what the application raises it keeps to itself
