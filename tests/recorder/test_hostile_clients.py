"""Clients that mean harm: nobody keeps the others waiting, takes memory without end, or stays for ever."""

from __future__ import annotations

import contextlib
import gc
import select
import socket
import time
import urllib.error
import urllib.request
from contextlib import ExitStack
from pathlib import Path

import pytest
import websocket

from recorder.server import (
    connection_guard,
    eventlet_host,
    telemetry_server,
)
from recorder.server.connection_guard import AllowedHosts
from recorder.server.websocket import MAX_FRAMES, NOTICES_BROKEN, TOO_LARGE
from tests.helpers.driving import PATIENCE_S
from tests.helpers.serving import (
    UNUSED,
    Book,
    PollingClient,
    RawClient,
    Serving,
    steered,
    tell,
)
from tests.helpers.waiting import wait_until


def sent_until_hung_up(stream: socket.socket, data: bytes, pause_s: float = 0.0, most: int = 1 << 30) -> int:
    """How often `data` could be sent."""
    stream.settimeout(PATIENCE_S)
    count = 0
    with contextlib.suppress(ConnectionError):
        while count < most:
            stream.sendall(data)
            count += 1
            time.sleep(pause_s)
            if select.select([stream], [], [], 0)[0] and not stream.recv(1 << 16):
                break
    return count


# Those who take their time


@pytest.mark.parametrize(
    "begin",
    ["GET {} HTTP/1.1\r\nX: ", "POST {} HTTP/1.1\r\nContent-Length: 99999\r\n\r\n"],
    ids=["a head without end", "a body that drips"],
)
def test_a_request_that_comes_byte_by_byte_is_not_waited_for(begin: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with Serving(Book()) as serving:
        path = PollingClient(serving.port).path
        monkeypatch.setattr(connection_guard, "REQUEST_S", 0.2)
        with socket.create_connection(("127.0.0.1", serving.port), PATIENCE_S) as slow:
            slow.sendall(begin.format(path).encode())
            # a byte is never long in coming: only the whole is
            assert sent_until_hung_up(slow, b"x", pause_s=0.01, most=2_000) < 2_000
        monkeypatch.setattr(connection_guard, "REQUEST_S", PATIENCE_S)
        assert len(tell(serving.port, range(3))) == 3


def test_clients_that_leave_before_their_answer_leave_no_open_file(monkeypatch: pytest.MonkeyPatch) -> None:
    """At once, and not when memory is looked through next: that may be hours later."""
    files = Path("/proc/self/fd")
    if not files.exists():
        pytest.skip("open files were not counted: this system does not list them")
    with Serving(Book()) as serving:
        assert len(tell(serving.port, range(1))) == 1
        monkeypatch.setattr(connection_guard, "REQUEST_S", 0.05)
        before = len(list(files.iterdir()))
        gc.disable()
        try:
            for _ in range(5):
                with socket.create_connection(("127.0.0.1", serving.port), PATIENCE_S) as slow:
                    slow.sendall(b"GET / HTTP/1.1\r\nX: ")
                    sent_until_hung_up(slow, b"x", pause_s=0.01)
            wait_until(lambda: len(list(files.iterdir())) <= before)
        finally:
            gc.enable()


def test_connections_beyond_the_limit_are_refused_and_places_come_free(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(eventlet_host, "MAX_CONNECTIONS", 4)
    with Serving(Book()) as serving, ExitStack() as crowd:
        for _ in range(8):
            crowd.enter_context(socket.create_connection(("127.0.0.1", serving.port), PATIENCE_S))
        wait_until(lambda: connection_guard.NOTICE_TOO_MANY in serving.notices)
        crowd.close()
        assert len(tell(serving.port, range(3))) == 3


def test_who_begins_to_poll_and_never_comes_back_does_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(telemetry_server, "MAX_CONNECTIONS", 5)
    with Serving(Book()) as serving:
        for _ in range(5):
            PollingClient(serving.port)
        with pytest.raises(urllib.error.HTTPError) as refused:
            PollingClient(serving.port)
        refused.value.close()
        assert connection_guard.NOTICE_TOO_MANY in serving.notices
        assert len(tell(serving.port, range(3))) == 3  # it keeps no simulator out


# Those who do not read


def test_a_client_that_reads_no_answers_delays_nobody() -> None:
    book = Book()
    with Serving(book) as serving:
        deaf = RawClient(serving.port)
        frame = websocket.ABNF.create_frame(b'42["telemetry",1]', websocket.ABNF.OPCODE_TEXT).format()
        deaf.stream.setblocking(False)
        while select.select([], [deaf.stream], [], 0.5)[1]:  # until the server reads no more either
            with contextlib.suppress(BlockingIOError):
                deaf.stream.send(frame * 1000)
        assert len(tell(serving.port, range(5))) == 5
        ticks = book.ticks
        wait_until(lambda: book.ticks > ticks)
        serving.stop()
        deaf.vanish()


def test_what_a_client_does_not_read_is_bounded() -> None:
    """By polling, where nothing is read before it is asked for."""
    book = Book()
    with Serving(book) as serving:
        client = PollingClient(serving.port)
        for _ in range(telemetry_server.MAX_UNREAD_PACKETS + 1):
            client.request('42["telemetry",1]')
        wait_until(lambda: "disconnected" in book.calls)
        assert book.calls.count("telemetry") <= telemetry_server.MAX_UNREAD_PACKETS + 1
        assert telemetry_server.NOTICE_NOT_READING in serving.notices


@pytest.mark.parametrize("content", [b"", b"x"])
def test_frames_that_hold_next_to_nothing_are_not_kept_without_end(content: bytes) -> None:
    with Serving(Book()) as serving:
        client = RawClient(serving.port)
        size = bytes([0x80 | len(content)])
        client.stream.sendall(b"\x01" + size + bytes(4) + content)
        most = 2 * MAX_FRAMES
        with contextlib.suppress(ConnectionError):
            for _ in range(most // 1000):
                client.stream.sendall((b"\x00" + size + bytes(4) + content) * 1000)
        client.until_hung_up()
        wait_until(lambda: NOTICES_BROKEN[TOO_LARGE] in serving.notices)


# Those who send without end


@pytest.mark.parametrize("header", ["Content-Length: -1", "Content-Length: x", "Transfer-Encoding: chunked"])
def test_a_body_whose_size_is_not_reported_is_not_read(header: str) -> None:
    with Serving(Book()) as serving:
        client = PollingClient(serving.port)
        with socket.create_connection(("127.0.0.1", serving.port), PATIENCE_S) as stream:
            stream.sendall(f"POST {client.path} HTTP/1.1\r\nHost: localhost\r\n{header}\r\n\r\n".encode())
            assert sent_until_hung_up(stream, b"x" * 65536, most=1000) < 1000
        assert len(tell(serving.port, range(3))) == 3


def test_a_client_has_one_place_however_often_it_connects() -> None:
    book = Book()
    with Serving(book) as serving:
        client = RawClient(serving.port, *["40"] * 50)
        client.tell(1)
        assert client.command() == steered(UNUSED)
        client.close()
        wait_until(lambda: "disconnected" in book.calls)
        assert book.calls == ["connected", "telemetry", "answered", "disconnected"]


# Web pages of other sites, in the user's own browser


def asked(port: int, path: str, **headers: str) -> int:
    """The status that a request is answered by."""
    head = "".join(f"{name.replace('_', '-')}: {value}\r\n" for name, value in headers.items())
    with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as stream:
        stream.sendall(f"GET {path} HTTP/1.1\r\n{head}\r\n".encode())
        return int(stream.recv(1 << 16).split()[1])


POLL = "/socket.io/?EIO=4&transport=polling"
WEBSOCKET = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec_WebSocket_Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    "Sec_WebSocket_Version": "13",
}


@pytest.mark.parametrize(
    ("headers", "is_let_in"),
    [
        ({"Host": "localhost:4567"}, True),
        ({}, True),
        ({"Host": "evil.example:4801", "Origin": "http://evil.example:4801"}, False),  # DNS rebinding
        ({"Host": "127.0.0.1:4567", "Origin": "http://evil.example", "X_Forwarded_Host": "evil.example"}, False),
    ],
)
def test_no_page_of_another_site_is_let_in_by_whatever_name_it_comes(
    headers: dict[str, str], is_let_in: bool
) -> None:
    with Serving(Book()) as serving:
        websocket_path = POLL.replace("polling", "websocket")
        assert asked(serving.port, POLL, **headers) == (200 if is_let_in else 403)
        assert asked(serving.port, websocket_path, **WEBSOCKET, **headers) == (101 if is_let_in else 403)
        assert sum("refused a web page" in line for line in serving.notices) == (not is_let_in)


@pytest.mark.parametrize(
    ("host", "name", "origin", "is_let_in"),
    [
        ("0.0.0.0", "192.168.0.7:4567", None, True),
        ("::", "[2001:db8::1]:4567", None, True),
        ("0.0.0.0", "mybox:4567", None, True),
        ("0.0.0.0", "evil.example", None, False),
        ("0.0.0.0", "192.168.0.7:4567", "http://192.168.0.7:4567", True),
        ("0.0.0.0", "192.168.0.7:4567", "http://203.0.113.5", False),
        ("0.0.0.0", "mybox", "http://evil.example", False),
        ("192.168.0.7", "192.168.0.7:4567", None, True),
        ("192.168.0.7", "192.168.0.8:4567", None, False),
        ("car.example.org", "car.example.org:4567", "http://car.example.org", True),
        ("car.example.org", "mybox", None, False),
        ("127.0.0.1", "LocalHost.:80", None, True),
        ("127.0.0.1", "[::1]:4567", None, True),
        ("127.0.0.1", "evil.example:4801", None, False),
        ("127.0.0.1", "192.168.0.7:4567", None, False),
        ("127.0.0.1", "127.0.0.1:4567", "http://evil.example", False),
        ("127.0.0.1", "127.0.0.1:4567", "null", False),
        ("127.0.0.1", "localhost@evil.example", None, False),
        ("127.0.0.1", "evil.example@127.0.0.1", None, False),
        ("127.0.0.1", "[::1].evil.example", None, False),
        ("127.0.0.1", "127.0.0.1\\@evil.example", None, False),
        ("127.0.0.1", "127.0.0.1", "http://evil.example@127.0.0.1", False),
        ("0.0.0.0", "evil.example@192.168.0.7", None, False),
        ("0.0.0.0", "[fe80::7]:4567", "http://[fe80::7]:4567", True),
    ],
)
def test_what_host_names_is_let_in(host: str, name: str, origin: str | None, is_let_in: bool) -> None:
    environ = {"HTTP_HOST": name} | ({} if origin is None else {"HTTP_ORIGIN": origin})
    assert (AllowedHosts(host).why_refused(environ) == "") == is_let_in
