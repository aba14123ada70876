"""A client's websocket, as python-engineio uses one: `wait`, `send` and `close`.

python-engineio's own are eventlet's, which unmasks what it receives byte by byte in Python (measured: 2.5 ms a
telemetry, 0.15 ms here), and simple-websocket's, where every telemetry changes threads before it is looked at.
Here whoever waits also reads, in every mode of the server.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from wsproto import ConnectionType, WSConnection
from wsproto.connection import ConnectionState
from wsproto.events import AcceptConnection, BytesMessage, CloseConnection, Event, Message, Ping, TextMessage
from wsproto.frame_protocol import CloseReason
from wsproto.utilities import LocalProtocolError

RECEIVE_BYTES: Final = 1 << 16
FRAME_BYTES: Final = 100
"""What a frame counts for beside its content: keeping it costs that, were it empty."""
DRAIN_S: Final = 1.0
"""How long a client that was hung up on may go on sending: closed at once, it might lose what it was sent last."""


TOO_LARGE, BROKEN_FRAME = "message too large", "broken frame"


class WireError(ValueError):
    """A request that is no websocket's."""


class Wire:
    """An open websocket. One thread waits for messages; any thread may send."""

    def __init__(
        self,
        stream: socket.socket,
        headers: list[tuple[bytes, bytes]],
        *,
        most_bytes: int,
        lock: contextlib.AbstractContextManager[Any],
        give_way: Callable[[], object],
    ) -> None:
        """Accept the upgrade that `headers` ask for. A message is at most `most_bytes` long, each of its frames
        counting `FRAME_BYTES`. `lock` keeps what
        several threads send apart; `give_way` is called between messages, and lets other green threads in, which a
        client that always has something to say would keep out. Raises WireError if it is none, OSError if the
        client has gone."""
        self.received_s = 0.0
        """`time.perf_counter()` when the last byte of the last message had come."""
        self.broke = ""
        """Why the client was hung up on (TOO_LARGE, BROKEN_FRAME); empty if it was not."""
        self._stream = stream
        self._most_bytes = most_bytes
        self._lock = lock
        self._give_way = give_way
        self._protocol = WSConnection(ConnectionType.SERVER)
        self._parts: list[Any] = []
        self._size = 0
        self._messages: deque[str | bytes] = deque()
        self._is_over = False
        self._closed_s: float | None = None
        try:
            self._protocol.initiate_upgrade_connection(headers, "/")
            reply = self._protocol.send(AcceptConnection())
        except Exception as error:  # h11's, wsproto's and Unicode's: the headers may be anything
            raise WireError(str(error)) from None
        for _ in self._protocol.events():
            pass  # the request
        stream.sendall(reply)

    def wait(self) -> str | bytes | None:
        """The next message; None when the connection is over."""
        self._give_way()
        while not self._messages:
            if self._is_over:
                return None
            try:
                data = self._stream.recv(RECEIVE_BYTES)
            except (OSError, EOFError):  # the latter is eventlet's
                data = b""
            self.received_s = time.perf_counter()
            if not data:
                self._is_over = True
            elif self._closed_s is None:
                self._read(data)
            else:
                self._is_over = self.received_s - self._closed_s > DRAIN_S
        return self._messages.popleft()

    def send(self, message: str | bytes) -> None:
        """Returns when the system has taken it. Raises OSError if the client has gone."""
        if isinstance(message, str):
            self._send(TextMessage(data=message))
        else:
            self._send(BytesMessage(data=bytes(message)))

    def close(self, code: CloseReason = CloseReason.NORMAL_CLOSURE) -> None:
        """Say so and send no more; whoever waits hears of it when the client has closed too."""
        self._closed_s = time.perf_counter()
        with contextlib.suppress(OSError):
            self._send(CloseConnection(code=code))
            self._stream.shutdown(socket.SHUT_WR)

    def cut(self) -> None:
        """End it at once, also where somebody waits for the client to read what it is sent."""
        self._is_over = True
        with contextlib.suppress(OSError):
            self._stream.shutdown(socket.SHUT_RDWR)

    def _send(self, event: Event) -> None:
        with self._lock:
            try:
                data = self._protocol.send(event)
            except LocalProtocolError:
                raise ConnectionResetError("the websocket is closed") from None
            try:
                self._stream.sendall(data)
            except OSError:  # it may have got a part, or wait for ever: nothing more can be told
                self.cut()
                raise

    def _read(self, data: bytes) -> None:
        self._protocol.receive_data(data)
        for event in self._protocol.events():
            if isinstance(event, Message):
                self._parts.append(event.data)
                self._size += len(event.data) + FRAME_BYTES
                if self._size > self._most_bytes:
                    self._break(TOO_LARGE, CloseReason.MESSAGE_TOO_BIG)
                    return
                if event.message_finished:
                    is_text = isinstance(event, TextMessage)
                    self._messages.append("".join(self._parts) if is_text else b"".join(self._parts))
                    self._parts, self._size = [], 0
            elif isinstance(event, Ping):
                with contextlib.suppress(OSError):
                    self._send(event.response())
                self._give_way()
            elif isinstance(event, CloseConnection):
                if self._protocol.state is ConnectionState.OPEN:  # it is wsproto that wants to close
                    self._break(BROKEN_FRAME, CloseReason.PROTOCOL_ERROR)
                else:
                    self._is_over = True
                    self.close()
                return

    def _break(self, reason: str, code: CloseReason) -> None:
        self.broke = reason
        self.close(code)
