"""An Engine.IO connection that answers in the thread that read the message, and limits a client's cost.

`Connection.adopt` converts a connection of python-engineio. Nothing is patched for other users in the process.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from engineio import packet
from engineio.socket import Socket

from recorder.server.eventlet_host import STREAM, leave_unanswered, let_others_run, make_lock
from recorder.server.in_flight import InFlight
from recorder.server.websocket import BROKEN_FRAME, TOO_LARGE, HandshakeError, WebSocket

CONNECT, EVENT = "0", "2"  # Socket.IO packet types, the first character of an Engine.IO message
BROKEN_PACKET: Final = "broken packet"

MAX_UNREAD_PACKETS: Final = 64
"""The most packets that wait until a client reads them. Answers to a websocket's telemetry never wait."""
MAX_ECHOED_CHARACTERS: Final = 100  # of a heartbeat's content

NOTICE_BROKEN: Final = (
    "disconnected a client that broke the Socket.IO protocol: a simulator in autonomous mode does not, other"
    " clients need python-socketio 5 or its like"
)
NOTICE_NOT_READING: Final = (
    "disconnected a client that does not read its messages: if it is your simulator, start it again"
)
NOTICES_HUNG_UP: Final = {
    TOO_LARGE: "disconnected a client that sent too much at once: a picture has 320x160 pixels and about 15 KB",
    BROKEN_FRAME: (
        "disconnected a client that broke the websocket protocol: if it is your simulator, start it again"
    ),
}


class Received(NamedTuple):
    sid: str
    data: object
    received_s: float


class Connection(Socket):  # type: ignore[misc]
    """Answers in the green thread that read the message. The server's tick sends its pings. Serves clients of
    Socket.IO 2, such as the real simulator, like modern ones.

    More threads would delay the answer. A thread that sleeps until the next ping would outlive the run.
    """

    has_sent_message = False
    is_announced = False  # its first message has come
    awaits_first_command = True  # no telemetry has come, and no command was sent
    first_command_sent = False  # before any telemetry
    in_flight: InFlight[Received]
    last_ping: Any
    _notify: Callable[[str], None]
    _websocket: WebSocket | None = None
    _since_s: float  # time.monotonic()
    _next_ping_s: float

    @classmethod
    def adopt(cls, connection: Any, notify: Callable[[str], None]) -> None:
        """Convert a new connection of python-engineio to this class. `notify` gets the reason if the client is
        disconnected."""
        connection.__class__ = cls
        connection.in_flight, connection._notify = InFlight(), notify
        connection._since_s = connection._next_ping_s = time.monotonic()

    @property
    def is_websocket(self) -> bool:
        return bool(self.upgraded)

    @property
    def received_s(self) -> float:
        """`time.perf_counter()` when the last message had arrived; with long polling, now."""
        return time.perf_counter() if self._websocket is None else self._websocket.received_s

    @property
    def taken_s(self) -> float:
        """`time.perf_counter()` when the handling of the last message began; with long polling, now."""
        return time.perf_counter() if self._websocket is None else self._websocket.taken_s

    @property
    def has_unread(self) -> bool:
        websocket = self._websocket
        return websocket is not None and (bool(websocket.waiting) or websocket.has_unread)

    @property
    def waiting(self) -> list[str | bytes]:
        """The messages that were read, but not handled yet."""
        return [] if self._websocket is None else self._websocket.waiting

    def look(self) -> None:
        """Read newly arrived data. Only the green thread that reads may call it."""
        if self._websocket is not None:
            self._websocket.look()

    def is_older_than(self, seconds: float) -> bool:
        return time.monotonic() - self._since_s >= seconds

    def has_waited(self, seconds: float) -> bool:
        """True for a websocket older than `seconds` without any telemetry or first command."""
        return self.is_websocket and self.awaits_first_command and not self.closed and self.is_older_than(seconds)

    def send_first_command(self, message: str, now_s: float) -> None:
        """Send a command before any telemetry, once. `now_s`: of the server's `RunningClock`."""
        self.awaits_first_command, self.first_command_sent = False, True
        self.in_flight.pushed(now_s)
        self.send(packet.Packet(packet.MESSAGE, data=message))

    def send_directly(self, message: str) -> bool:
        """Send over the websocket; False for long polling, where a client fetches its messages."""
        if self._websocket is None or not self.upgraded:
            return False
        self._websocket.send(packet.Packet(packet.MESSAGE, data=message).encode())
        return True

    def tick(self) -> None:
        """Ping the client if a ping is due, and close the connection if the client has gone."""
        if not self.closed and self.check_ping_timeout() and self.last_ping is None:
            now_s = time.monotonic()
            if now_s >= self._next_ping_s:
                self.last_ping = time.time()
                self.send(packet.Packet(packet.PING))

    def schedule_ping(self) -> None:
        self.last_ping = None
        self._next_ping_s = time.monotonic() + self.server.ping_interval

    def receive(self, pkt: packet.Packet) -> None:
        if self.closed:
            return  # the client did not know this yet
        self.has_sent_message |= pkt.packet_type == packet.MESSAGE
        if pkt.packet_type == packet.PING:  # a modern client never sends one
            data = pkt.data if isinstance(pkt.data, str) else ""
            self.send(packet.Packet(packet.PONG, data=data[:MAX_ECHOED_CHARACTERS]))
        else:
            super().receive(pkt)

    def hand_over(self, message: str | bytes, received: Callable[[str, str | bytes], object]) -> None:
        """Give a message to python-socketio's `received`, and hang up if it breaks the protocol.

        A client of Socket.IO 2 sends no CONNECT packet. Without this packet, python-socketio 5 silently drops all
        events, so it is added here.
        """
        if not message:
            return  # it breaks nothing
        try:
            if not self.is_announced:
                self.is_announced = True
                if isinstance(message, str) and message.startswith(EVENT):
                    received(self.sid, CONNECT)
            received(self.sid, message)
        except Exception:  # its parser raises nearly anything; handlers' errors are caught before
            self.hang_up()

    def hang_up(self) -> None:
        """Close the connection: its client broke the protocol."""
        if not self.closed:
            self._notify(NOTICE_BROKEN)
            self.close(wait=False, reason=BROKEN_PACKET)

    def send(self, pkt: packet.Packet) -> None:
        """Queue a packet to send later, or for a polling client to fetch."""
        if self.queue.qsize() < MAX_UNREAD_PACKETS:
            super().send(pkt)
        elif not self.closing:
            self._notify(NOTICE_NOT_READING)
            self.close(wait=False, abort=True)
            if self._websocket is not None:
                self._websocket.cut()

    def close(self, wait: bool = True, abort: bool = False, reason: str | None = None) -> None:
        if self._websocket is not None and self._websocket.broken_by:
            reason = self._websocket.broken_by
        super().close(wait=False, abort=abort, reason=reason)

    def _upgrade_websocket(self, environ: dict[str, Any], start_response: Callable[..., Any]) -> Any:
        names = ("Host", "Upgrade", "Connection", "Sec-WebSocket-Key", "Sec-WebSocket-Version")
        values = {name: environ.get("HTTP_" + name.upper().replace("-", "_")) for name in names}
        headers = [(name, value) for name, value in values.items() if value is not None]
        stream = environ[STREAM]
        stream.settimeout(self.server.ping_interval + self.server.ping_timeout)
        try:
            websocket = WebSocket(
                stream,
                headers,
                max_bytes=self.server.max_http_buffer_size,
                lock=make_lock(),
                let_others_run=let_others_run,
            )
        except HandshakeError as error:
            self.close(wait=False, abort=True)
            return self.server._bad_request(str(error))
        self._websocket = websocket
        try:
            if not self.connected:  # a connection that begins as a websocket: the greeting comes first
                for pkt in self.poll():
                    websocket.send(pkt.encode())
            self._websocket_handler(websocket)
        finally:
            websocket.close()
            if websocket.broken_by:
                self._notify(NOTICES_HUNG_UP[websocket.broken_by])
            leave_unanswered()
        return []
