"""A proxy before a store's server, in this process: it counts what passes, waits, and fails as the test says.

What fails is the way to the server. The server is a real one, and has or has not done what it was asked: a client
that gets no answer cannot know which.
"""

from __future__ import annotations

import contextlib
import http.client
import itertools
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

Answer = Callable[["Passing"], bool]
"""Answers a request in the place of the server, or returns False."""

_OF_THE_WAY = {"connection", "transfer-encoding", "content-length", "date", "server"}  # headers the proxy writes


class Passing(BaseHTTPRequestHandler):
    """A connection of a client; each request on it goes on to the server, unless the proxy's `answer` takes it."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    proxy: FaultyProxy

    def log_message(self, *arguments: object) -> None: ...

    def setup(self) -> None:
        super().setup()
        self._server = http.client.HTTPConnection("127.0.0.1", self.proxy.server_port)

    def finish(self) -> None:
        self._server.close()
        super().finish()

    def _answered(self) -> None:
        self._to_come = int(self.headers.get("Content-Length") or 0)
        with self.proxy.lock:
            self.number = len(self.proxy.requests)
            self.proxy.requests.append((self.command, self.path, 0))
        time.sleep(self.proxy.delay_s)
        if not self.proxy.answer(self):
            status, headers, data = self._passed()
            self._send(status, headers, data)

    do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = _answered  # noqa: N815

    def fail(self, status: int, code: str) -> bool:
        """Answer with an error of S3; the server is not asked."""
        self._sent(self._to_come)
        body = f"<Error><Code>{code}</Code><Message>as the test says</Message></Error>".encode()
        return self._send(status, [], body)

    def hang_up(self) -> bool:
        """Cut the connection in the middle of what is sent; the server is not asked."""
        self._sent(self._to_come // 2)
        return self._close()

    def lose(self) -> bool:
        """The server does what it was asked, and the connection is cut before a word of its answer."""
        self._passed()
        return self._close()

    def cut(self) -> bool:
        """The server does what it was asked, and the connection is cut in the middle of its answer's bytes."""
        status, headers, data = self._passed()
        if data:
            self._send(status, headers, data[: len(data) // 2], announced=len(data))
        return self._close()

    def truncate(self) -> bool:
        """The first half of an answer, as if it were all: what comes ends early, and says so nowhere but in what
        the range is said to be."""
        status, headers, data = self._passed()
        return self._send(status, headers, data[: len(data) // 2])

    def fail_after(self) -> bool:
        """The server does what it was asked, and the answer is that it could not."""
        self._passed()
        return self.fail(500, "InternalError")

    def _sent(self, count: int) -> bytes:
        """So many bytes more of what the client sends."""
        self._to_come -= count
        return self.rfile.read(count)

    def _close(self) -> bool:
        self.close_connection = True
        return True

    def _passed(self) -> tuple[int, list[tuple[str, str]], bytes]:
        """What the server answers."""
        self._server.putrequest(self.command, self.path, skip_accept_encoding=True)
        for name, value in self.headers.items():
            if name.lower() not in ("connection", "host"):
                self._server.putheader(name, value)
        self._server.endheaders(self._sent(self._to_come))
        answer = self._server.getresponse()
        data = answer.read()
        self._length = answer.getheader("Content-Length")  # also of what HEAD asks about
        return answer.status, answer.getheaders(), data

    def _send(
        self, status: int, headers: list[tuple[str, str]], data: bytes, announced: int | None = None
    ) -> bool:
        is_head = self.command == "HEAD"
        length = self._length if is_head and headers else len(data) if announced is None else announced
        self.send_response(status)
        for name, value in headers:
            if name.lower() not in _OF_THE_WAY:
                self.send_header(name, value)
        if status not in (204, 304):
            self.send_header("Content-Length", str(length))
        if not is_head:  # before the client has its answer: it may look at once, or have the book cleared
            self.proxy.requests[self.number] = (self.command, self.path, len(data))
        self.end_headers()
        if not is_head:
            self.wfile.write(data)
        return True


FAULTS: dict[str, Answer] = {
    "503": lambda passing: passing.fail(503, "SlowDown"),
    "500": lambda passing: passing.fail(500, "InternalError"),
    "500 after it was done": Passing.fail_after,
    "hung up": Passing.hang_up,
    "lost": Passing.lose,
    "cut": Passing.cut,
    "truncated": Passing.truncate,
}
"""What a client has to get over by asking again."""


class FaultyProxy:
    """What it was asked for, and how it fails."""

    def __init__(self) -> None:
        self.requests: list[tuple[str, str, int]] = []  # method, path with its query, bytes answered
        self.delay_s = 0.0
        self.answer: Answer = lambda passing: False
        self.server_port = 0
        self.endpoint = ""  # the proxy's own, for clients
        self.lock = threading.Lock()

    def count(self, method: str = "") -> int:
        return sum(method in ("", each[0]) for each in self.requests)

    @property
    def bytes_sent(self) -> int:
        return sum(sent for _, _, sent in self.requests)

    def fail_at(self, number: int, fault: Answer) -> None:
        """Begin to count anew, and let the request of this number fail, from 0; only this one."""
        self.requests.clear()
        self.answer = lambda passing: passing.number == number and fault(passing)

    def fail_first(self, method: str, fault: Answer) -> None:
        """Let the next request of this kind fail; only this one."""
        first = iter([True])
        self.answer = lambda passing: passing.command == method and next(first, False) and fault(passing)

    def fail_each_once(self) -> None:
        """Let each request fail the first time that it comes, by all faults in turn."""
        seen: set[tuple[str, ...]] = set()
        turns = itertools.cycle(FAULTS.values())

        def fail(passing: Passing) -> bool:
            request = (passing.command, passing.path, passing.headers.get("Range", ""))
            with self.lock:
                if request in seen:
                    return False
                seen.add(request)
                fault = next(turns)
            return fault(passing)

        self.answer = fail

    def pass_all(self) -> None:
        self.requests.clear()
        self.answer = lambda passing: False

    @contextlib.contextmanager
    def before(self, server_port: int) -> Iterator[None]:
        """Stand before a server of this machine."""
        self.server_port = server_port
        with serving(type("Passing", (Passing,), {"proxy": self})) as port:
            self.endpoint = f"http://127.0.0.1:{port}"
            yield


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """A client that has gone is no error here."""


@contextlib.contextmanager
def serving(handler: type[BaseHTTPRequestHandler]) -> Iterator[int]:
    """Serve on a port of this machine, each connection by a thread."""
    with _Server(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
        thread.start()
        try:
            yield server.server_port
        finally:
            server.shutdown()
            thread.join()
