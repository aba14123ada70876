"""A client's websocket: what comes in frames of any size, what is no websocket, and how it ends."""

from __future__ import annotations

import contextlib
import random
import socket
import struct
import threading
from collections.abc import Callable, Iterator

import pytest
from websocket import ABNF

from recorder.server.websocket import BROKEN_FRAME, TOO_LARGE, HandshakeError, WebSocket
from tests.helpers.waiting import PATIENCE_S

MAX_BYTES = 100_000
HEADERS = {
    "Host": "x",
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",  # RFC 6455
    "Sec-WebSocket-Version": "13",
}
ACCEPTED = b"s3pPLMBiTxaQ9kYGzzhZRbK+xOo="
TEXT, BINARY, CONTINUATION, PING, CLOSE = (
    ABNF.OPCODE_TEXT,
    ABNF.OPCODE_BINARY,
    ABNF.OPCODE_CONT,
    ABNF.OPCODE_PING,
    ABNF.OPCODE_CLOSE,
)


def make_wire(
    stream: socket.socket, headers: dict[str, str], let_others_run: Callable[[], object] = lambda: None
) -> WebSocket:
    named = list(headers.items())
    return WebSocket(stream, named, max_bytes=MAX_BYTES, lock=threading.Lock(), let_others_run=let_others_run)


@pytest.fixture
def ends() -> Iterator[tuple[WebSocket, socket.socket]]:
    """The server's end, and the client's, which has shaken hands."""
    near, far = socket.socketpair()
    with near, far:
        near.settimeout(PATIENCE_S)
        far.settimeout(PATIENCE_S)
        websocket = make_wire(near, HEADERS)
        assert ACCEPTED in far.recv(1000)
        yield websocket, far


def frame(opcode: int, data: bytes, *, is_last: bool = True) -> bytes:
    """As a client sends it, by websocket-client."""
    return bytes(ABNF(int(is_last), 0, 0, 0, opcode, 1, data).format())


def in_frames(opcode: int, data: bytes, size: int) -> bytes:
    parts = [data[at : at + size] for at in range(0, len(data), size)]
    last = len(parts) - 1
    return b"".join(
        frame(opcode if number == 0 else CONTINUATION, part, is_last=number == last)
        for number, part in enumerate(parts)
    )


def received(far: socket.socket) -> tuple[int, bytes]:
    """The opcode and the data of a server's frame, which is neither masked nor long."""
    first, size = far.recv(2)
    return first & 15, far.recv(size) if size else b""


@pytest.mark.parametrize("size", [1, 7, 1016, 30_000])
def test_messages_in_frames_of_any_size_and_in_any_pieces(
    ends: tuple[WebSocket, socket.socket], size: int
) -> None:
    websocket, far = ends
    chance = random.Random(size)
    text = "".join(chance.choice("aä€😀") for _ in range(200 if size < 1016 else 20_000))
    binary = chance.randbytes(min(900 * size, 60_000))
    sent = in_frames(TEXT, text.encode(), size) + in_frames(BINARY, binary, size)

    def send() -> None:
        at = 0
        while at < len(sent):
            at += far.send(sent[at : at + chance.randint(1, 3 * size + 10)])

    sender = threading.Thread(target=send)
    sender.start()
    assert websocket.wait() == text
    assert websocket.wait() == binary
    sender.join()


def test_a_ping_within_a_message_is_answered_at_once(ends: tuple[WebSocket, socket.socket]) -> None:
    websocket, far = ends
    far.sendall(frame(TEXT, b"a", is_last=False) + frame(PING, b"there?"))
    waiting = threading.Thread(target=websocket.wait)
    waiting.start()
    assert received(far) == (ABNF.OPCODE_PONG, b"there?")
    far.sendall(frame(CONTINUATION, b"b"))
    waiting.join(5.0)
    assert not waiting.is_alive()


@pytest.mark.parametrize(
    ("data", "reason", "code"),
    [
        (frame(TEXT, b"\xff\xfe"), BROKEN_FRAME, 1007),
        (frame(CONTINUATION, b"of what?"), BROKEN_FRAME, 1002),
        (b"\x81\x02hi", BROKEN_FRAME, 1002),  # not masked
        (b"\x83\x80\0\0\0\0", BROKEN_FRAME, 1002),  # no such kind
        (frame(TEXT, b"a", is_last=False) + frame(TEXT, b"b"), BROKEN_FRAME, 1002),
        (in_frames(TEXT, b"x" * (MAX_BYTES + 1), 30_000), TOO_LARGE, 1009),
        # a terabyte that is only announced
        (b"\x82\xff" + struct.pack("!Q", 1 << 40), TOO_LARGE, 1009),
    ],
    ids=[
        "no text",
        "goes on with nothing",
        "not masked",
        "no such kind",
        "within a text",
        "too large",
        "a terabyte",
    ],
)  # masks are random, and names of tests must not be
def test_who_breaks_the_protocol_is_reported_and_heard_no_more(
    ends: tuple[WebSocket, socket.socket], data: bytes, reason: str, code: int
) -> None:
    websocket, far = ends
    far.sendall(frame(TEXT, b"before") + data + frame(TEXT, b"after"))
    far.shutdown(socket.SHUT_WR)
    assert websocket.wait() == "before"
    assert websocket.wait() is None
    assert websocket.broken_by == reason
    opcode, content = received(far)
    assert (opcode, struct.unpack("!H", content[:2])) == (CLOSE, (code,))
    with pytest.raises(ConnectionResetError):
        websocket.send("x")


def test_a_client_that_closes_gets_its_messages_handled_and_an_answer(
    ends: tuple[WebSocket, socket.socket],
) -> None:
    websocket, far = ends
    far.sendall(frame(TEXT, b"last") + frame(CLOSE, struct.pack("!H", 1001)) + frame(TEXT, b"too late"))
    assert websocket.wait() == "last"
    assert websocket.wait() is None
    assert not websocket.broken_by
    assert received(far) == (CLOSE, struct.pack("!H", 1001))


def test_a_client_that_closes_within_a_message_breaks_nothing(ends: tuple[WebSocket, socket.socket]) -> None:
    websocket, far = ends
    far.sendall(frame(TEXT, b"half", is_last=False) + frame(CLOSE, struct.pack("!H", 1001)))
    assert websocket.wait() is None
    assert not websocket.broken_by
    assert received(far)[0] == CLOSE


def test_what_a_client_sends_is_heard_while_it_reads_nothing(ends: tuple[WebSocket, socket.socket]) -> None:
    """Else nobody would notice that it does not read."""
    websocket, far = ends

    def send() -> None:
        with contextlib.suppress(OSError):
            websocket.send("x" * 10_000_000)

    sender = threading.Thread(target=send)
    sender.start()
    assert far.recv(2)  # of more than a system keeps
    far.sendall(frame(TEXT, b"still here"))
    assert websocket.wait() == "still here"
    assert sender.is_alive()
    websocket.cut()
    sender.join()


def test_a_message_that_was_sent_in_part_is_the_last_one(ends: tuple[WebSocket, socket.socket]) -> None:
    websocket, far = ends
    websocket._stream.settimeout(0.05)
    far.sendall(frame(TEXT, b"hi"))
    with pytest.raises(OSError, match="timed out"):
        websocket.send("x" * 10_000_000)
    assert websocket.wait() is None


@pytest.mark.parametrize(
    "wrong",
    [
        {"Upgrade": "h2c"},
        {"Connection": "close"},
        {"Sec-WebSocket-Key": "short"},
        {"Sec-WebSocket-Key": "ÿ"},
        {"Sec-WebSocket-Version": "8"},
        dict.fromkeys(HEADERS, ","),
        dict.fromkeys(HEADERS, "\0"),
    ],
)
def test_a_request_that_is_no_websockets_is_refused_in_one_line(
    wrong: dict[str, str], capfd: pytest.CaptureFixture[str]
) -> None:
    near, far = socket.socketpair()
    with near, far:
        with pytest.raises(HandshakeError) as refused:
            make_wire(near, HEADERS | wrong)
        assert str(refused.value)
        assert "\n" not in str(refused.value)
    assert capfd.readouterr().err == ""
