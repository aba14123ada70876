"""A client's websocket, as python-engineio calls it: also of clients of Socket.IO 2, such as the real simulator.

Why not eventlet's: it unmasks data byte by byte in Python (measured: 2.5 ms a telemetry, 0.1 ms here), a message
of endless frames fills its memory, and no other client runs while frames come without a pause. The protocol is the
websockets library's.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from websockets.datastructures import Headers
from websockets.exceptions import InvalidHandshake, InvalidState, PayloadTooBig
from websockets.frames import CloseCode, Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import Protocol, Side, State
from websockets.server import ServerProtocol

from recorder.server.connection_guard import has_unread

RECEIVE_BYTES: Final = 1 << 13  # parsed before other green threads run: 1,400 empty frames take some 3 ms
DRAIN_S: Final = 1.0
"""The time in which a disconnected client may still send. If it were cut at once, it might lose the last
message."""
MAX_FRAMES: Final = 50_000  # of a message; their memory adds to its content
MAX_WAITING: Final = 64
MAX_WAITING_BYTES: Final = 1 << 20
"""The most messages, and bytes of messages, that are read in advance; the system keeps the rest."""
DATA_OPCODES: Final = frozenset((Opcode.TEXT, Opcode.BINARY, Opcode.CONT))

PING, PONG, PROBE, CONNECT, EVENT = "2", "3", "2probe", "40", "42"  # how messages of Engine.IO begin
MAX_ECHOED_CHARACTERS: Final = 100  # of a ping's content

TOO_LARGE, BROKEN_FRAME = "message too large", "broken frame"
NOTICES_BROKEN: Final = {
    TOO_LARGE: "disconnected a client that sent too much at once: a picture has 320x160 pixels and about 15 KB",
    BROKEN_FRAME: (
        "disconnected a client that broke the websocket protocol: if it is your simulator, start it again"
    ),
}


class HandshakeError(ValueError):
    """A request that is not a websocket's handshake."""


class WebSocket:
    """An open websocket. One green thread waits for messages; any may send."""

    def __init__(
        self,
        stream: socket.socket,
        headers: list[tuple[str, str]],
        *,
        max_bytes: int,
        lock: contextlib.AbstractContextManager[Any],
        let_others_run: Callable[[], object],
    ) -> None:
        """Accept the upgrade that `headers` request.

        A message has at most `max_bytes`. `lock` is held during sending. `let_others_run` is called between
        messages: otherwise, a client that sends without a pause would block all other green threads.
        Raises HandshakeError if the headers do not request a websocket, OSError if the client has gone.
        """
        self.received_s = 0.0
        """`time.perf_counter()` when the last byte of the last message arrived, or earlier."""
        self.taken_s = 0.0  # `time.perf_counter()` when `wait` returned the last message; 0 before the first
        self.broken_by = ""
        """The violation that closed the connection (TOO_LARGE, BROKEN_FRAME); empty without one."""
        self.before_end: Callable[[], None] = lambda: None  # called before `wait` returns None
        self._stream = stream
        self._sending_lock = lock  # taken before frames are made, to send them in order
        self._let_others_run = let_others_run
        self._protocol = Protocol(Side.SERVER, max_size=max_bytes)
        self._parts: list[bytes] = []
        self._is_text = False
        self._messages: deque[tuple[str | bytes, float]] = deque()  # with their times of arrival
        self._looked_s = time.perf_counter()
        self._is_over = False
        self._closed_s: float | None = None
        handshake = ServerProtocol()
        try:
            response = handshake.accept(Request("/", Headers(headers)))
        except InvalidHandshake as error:
            raise HandshakeError(str(error)) from None
        if handshake.handshake_exc is not None:
            raise HandshakeError(str(handshake.handshake_exc))
        stream.sendall(response.serialize())

    def wait(self) -> str | bytes | None:
        """The next message; None when the connection is over.

        Engine.IO 3 has the client ping, and Socket.IO 2 has no CONNECT packet: a ping is answered here, and the
        packet is added before a first event.
        """
        while True:
            self._let_others_run()
            self.look()
            while not self._messages:
                if self._is_over:
                    self.before_end()
                    return None
                self._receive(None)
            message, self.received_s = self._messages.popleft()
            if isinstance(message, str) and message.startswith(PING) and message != PROBE:
                with contextlib.suppress(OSError):
                    self.send(PONG + message[1 : 1 + MAX_ECHOED_CHARACTERS])
                continue
            if not self.taken_s and isinstance(message, str) and message.startswith(EVENT):
                self._messages.appendleft((message, self.received_s))
                message = CONNECT
            self.taken_s = time.perf_counter()
            return message

    def look(self) -> None:
        """Read the data that has come since the last look. It counts as arrived at that look: its real time of
        arrival is not known. Only the green thread that waits may call it."""
        while len(self._messages) < MAX_WAITING and self._waiting_bytes < MAX_WAITING_BYTES and self.has_unread:
            self._receive(self._looked_s)
        self._looked_s = time.perf_counter()

    @property
    def has_unread(self) -> bool:
        return not self._is_over and has_unread(self._stream)

    @property
    def waiting(self) -> list[str | bytes]:
        """The messages that were read, but not returned by `wait` yet."""
        return [message for message, _ in self._messages]

    def send(self, message: str | bytes) -> None:
        """Send a message; returns when the system has taken it. Raises OSError if the client has gone."""
        with self._sending_lock:
            try:
                if isinstance(message, str):
                    self._protocol.send_text(message.encode())
                else:
                    self._protocol.send_binary(message)
            except InvalidState:
                raise ConnectionResetError("the websocket is closed") from None
            self._flush()

    def close(self, code: CloseCode = CloseCode.NORMAL_CLOSURE) -> None:
        """Send a close frame and nothing more; `wait` returns None when the client has closed, too."""
        self._closed_s = self._closed_s or time.perf_counter()
        with contextlib.suppress(OSError), self._sending_lock:
            if self._protocol.state is State.OPEN:
                self._protocol.send_close(code)
            self._flush()
            self._stream.shutdown(socket.SHUT_WR)

    def cut(self) -> None:
        """End the connection at once, even while `send` waits for the client."""
        self._is_over = True
        with contextlib.suppress(OSError):
            self._stream.shutdown(socket.SHUT_RDWR)

    @property
    def _waiting_bytes(self) -> int:
        return sum(len(message) for message, _ in self._messages)

    def _receive(self, arrived_s: float | None) -> None:
        """Read once. `arrived_s`: the data's time of arrival; None: now."""
        try:
            data = self._stream.recv(RECEIVE_BYTES)
        except (OSError, EOFError):  # the latter is eventlet's
            data = b""
        now_s = time.perf_counter()
        if arrived_s is None:
            self._looked_s = arrived_s = now_s
        if not data:
            self._is_over = True
        elif self._closed_s is None:
            self._parse(data, arrived_s)
        else:
            self._is_over = now_s - self._closed_s > DRAIN_S
        if len(data) == RECEIVE_BYTES:  # perhaps an endless stream
            self._let_others_run()

    def _parse(self, data: bytes, arrived_s: float) -> None:
        self._protocol.receive_data(data)
        frames = [event for event in self._protocol.events_received() if isinstance(event, Frame)]
        if any(frame.opcode not in DATA_OPCODES for frame in frames):
            with contextlib.suppress(OSError), self._sending_lock:
                self._flush()  # answers to pings, and to a close
        for frame in frames:
            if frame.opcode in DATA_OPCODES and not self.broken_by:
                self._add_frame(frame, arrived_s)
        why = self._protocol.parser_exc
        if self._protocol.close_rcvd is not None:  # also in the middle of a message, which stops the parser
            self._is_over = True
            self.close()
        elif why is not None:
            self._break(TOO_LARGE if isinstance(why, PayloadTooBig) else BROKEN_FRAME)

    def _add_frame(self, frame: Frame, arrived_s: float) -> None:
        if frame.opcode is not Opcode.CONT:
            self._is_text = frame.opcode is Opcode.TEXT
        self._parts.append(bytes(frame.data))
        if len(self._parts) > MAX_FRAMES:
            self._break(TOO_LARGE, CloseCode.MESSAGE_TOO_BIG)
        elif frame.fin:
            message = b"".join(self._parts)
            self._parts = []
            if not message or (self._is_text and message == b"4"):
                return  # an empty message breaks nothing
            try:
                self._messages.append((message.decode() if self._is_text else message, arrived_s))
            except UnicodeDecodeError:
                self._break(BROKEN_FRAME, CloseCode.INVALID_DATA)

    def _break(self, why: str, code: CloseCode = CloseCode.PROTOCOL_ERROR) -> None:
        self.broken_by = self.broken_by or why
        self.close(code)

    def _flush(self) -> None:
        """Send the pending bytes; `_sending_lock` is held. Raises OSError if the client has gone."""
        data = b"".join(self._protocol.data_to_send())
        if not data:
            return
        try:
            self._stream.sendall(data)
        except OSError:  # perhaps a part was sent: nothing more can follow
            self.cut()
            raise
