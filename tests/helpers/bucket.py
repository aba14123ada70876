"""A real S3 server (localbucket), in this process, that counts what it is asked for and fails as it is told."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import Any

import localbucket
import pytest

from common import object_store
from common.location import Url

Answer = Callable[["_Handler"], bool]
"""Answers a request in the place of the server, or returns False."""


class Bucket:
    """The bucket `logs` of a server, as a folder of this machine; what it is asked for; how it fails."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "logs"
        self.folder.mkdir(parents=True)
        self.requests: list[tuple[str, str, int]] = []  # method, path with its query, bytes answered
        self.delay_s = 0.0
        self.answer: Answer = lambda handler: False

    def url(self, key: str = "") -> Url:
        return Url("s3", "logs", key)

    def count(self, method: str = "") -> int:
        return sum(method in ("", each[0]) for each in self.requests)

    @property
    def bytes_sent(self) -> int:
        return sum(sent for _, _, sent in self.requests)


class _Handler(localbucket.S3Handler):  # type: ignore[misc]
    bucket: Bucket
    sent = 0
    wfile: Any

    def log_message(self, *arguments: object) -> None: ...

    def handle_one_request(self) -> None:
        self.sent = 0
        super().handle_one_request()

    def do_GET(self) -> None:  # noqa: N802
        self._answered(super().do_GET)

    def do_HEAD(self) -> None:  # noqa: N802
        self._answered(super().do_HEAD)

    def do_PUT(self) -> None:  # noqa: N802
        self._answered(super().do_PUT)

    def do_POST(self) -> None:  # noqa: N802
        self._answered(super().do_POST)

    def do_DELETE(self) -> None:  # noqa: N802
        self._answered(super().do_DELETE)

    def _answered(self, usual: Callable[[], Any]) -> None:
        time.sleep(self.bucket.delay_s)
        at = len(self.bucket.requests)
        self.bucket.requests.append((self.command, self.path, 0))
        counted = _Counted(self.wfile)
        self.wfile = counted
        try:
            if not self.bucket.answer(self):
                usual()
        finally:
            self.wfile = counted.stream
            self.bucket.requests[at] = (self.command, self.path, counted.count)

    def fail(self, status: int, code: str) -> bool:
        """Answer with an error of S3."""
        body = f"<Error><Code>{code}</Code><Message>as the test says</Message></Error>".encode()
        if length := int(self.headers.get("Content-Length") or 0):
            self.rfile.read(length)
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)
        return True

    def cut(self) -> bool:
        """Cut the connection after some bytes of an answer."""
        self.send_response(206)
        self.send_header("Content-Length", "100000")
        self.send_header("Content-Range", "bytes 0-99999/100000")
        self.send_header("ETag", '"cut"')
        self.end_headers()
        self.wfile.write(b"some bytes")
        self.close_connection = True
        return True


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """A client that has gone is no error here."""


class _Counted:
    """A stream that counts what is written to it."""

    def __init__(self, stream: Any) -> None:
        self.stream = stream
        self.count = 0

    def write(self, data: bytes) -> int:
        self.count += len(data)
        written: int = self.stream.write(data)
        return written

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextlib.contextmanager
def serving_bucket(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bucket]:
    """Serve a bucket from `folder`; s3:// leads there as long as it runs, in this process and its children."""
    bucket = Bucket(folder)
    handler = type("Handler", (_Handler,), {"bucket": bucket, "data_root": folder})
    with _Server(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
        thread.start()
        for name, value in {
            "AWS_ENDPOINT_URL_S3": f"http://127.0.0.1:{server.server_port}",
            "AWS_ACCESS_KEY_ID": "test",
            "AWS_SECRET_ACCESS_KEY": "test",
            "AWS_REGION": "us-east-1",
        }.items():
            monkeypatch.setenv(name, value)
        object_store.forget_stores()
        try:
            yield bucket
        finally:
            server.shutdown()
            thread.join()
            object_store.forget_stores()
