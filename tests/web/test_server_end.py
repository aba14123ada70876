"""The end of bc-web is quiet, whatever its pages are waiting for."""

from __future__ import annotations

import asyncio
import http.client
import logging
import threading

import pytest
from starlette.types import Receive, Scope, Send

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
