"""The end of bc-web is quiet, whatever its pages are waiting for; so is that of a page."""

from __future__ import annotations

import asyncio
import http.client
import logging
import socket
import threading
from pathlib import Path

import pytest
from starlette.types import Receive, Scope, Send

from tests.helpers.workbench import served
from web.server.workbench_server import WorkbenchServer


def test_a_request_in_progress_prints_no_traceback_at_the_end(caplog: pytest.LogCaptureFixture) -> None:
    is_asked = threading.Event()

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        is_asked.set()
        await asyncio.sleep(3600)  # such as a network that is loaded for the first time

    server = WorkbenchServer(app, "127.0.0.1", 0)
    server.start()
    browser = http.client.HTTPConnection("127.0.0.1", server.port)
    browser.request("GET", "/")
    assert is_asked.wait(60)
    server.stop()
    browser.close()
    assert not [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("/jobs", "application/x-www-form-urlencoded"),
        ("/sessions.tags", "application/json"),
        ("/import.upload", "application/octet-stream"),
    ],
)
def test_a_page_that_leaves_while_it_sends_prints_no_traceback(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], path: str, kind: str
) -> None:
    with served(tmp_path) as bench:
        head = f"POST {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {bench.token}\r\n"
        head += f"Content-Type: {kind}\r\nContent-Length: 100\r\nExpect: 100-continue\r\n\r\n"
        with socket.create_connection(("127.0.0.1", bench.port)) as browser:
            browser.sendall(head.encode())
            assert browser.recv(100).startswith(b"HTTP/1.1 100")  # the server waits for the rest
            browser.sendall(b"the beginning")
    assert capfd.readouterr().err == ""
