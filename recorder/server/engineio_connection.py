"""A client's Engine.IO connection, where it is served otherwise than python-engineio does by itself.

Each becomes one by `adopt`, so that nothing of python-engineio is changed for anybody else in the process.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from typing import Any, Final, Protocol

from engineio import packet
from engineio.socket import Socket

from recorder.server.websocket import BROKEN_FRAME, TOO_LARGE, Wire, WireError

STREAM: Final = "telemetry.stream"
"""Where a request's environment holds its socket."""
HAS_HUNG_UP: Final = "telemetry.has_hung_up"
"""In the environment of a request that was a websocket's, and whose answer is over."""

MOST_UNREAD: Final = 64
"""So many packets may wait for a client to read them; answers to a websocket's telemetry never wait."""
MOST_ECHOED: Final = 100  # characters of a heartbeat, which come back

NOT_READ: Final = "hung up on a client that does not read what it is sent: simulators do, it is something else"
HUNG_UP: Final = {
    TOO_LARGE: "hung up on a client that sent too much at once: a picture has 320x160 pixels and about 15 KB",
    BROKEN_FRAME: "hung up on a client that broke the websocket protocol: simulators do not, it is something else",
}

Lock = AbstractContextManager[Any]


class Host(Protocol):
    """What runs the connections: green threads, or the system's own."""

    port: int

    def make_lock(self) -> Lock: ...

    def give_way(self) -> None:
        """Let other connections and the tick in."""
        ...

    def start(self, application: Callable[..., Iterable[bytes]]) -> None: ...

    def wait(self, seconds: float) -> None:
        """Serve whoever comes in the next while."""
        ...

    def after_websocket(self) -> Iterable[bytes]:
        """Instead of an answer to the request that became a websocket, which is over."""
        ...

    def end(self) -> None:
        """Wait for the connections that were closed to end, and end the others."""
        ...


class Connection(Socket):  # type: ignore[misc]
    """Sends an answer in the thread that has read the question, and is pinged by the server's tick: each thread
    more that an answer goes through may keep it waiting, and one that sleeps until the next ping outlives the run.
    """

    has_told: bool
    waits: bool  # has told no telemetry, and was sent no first command
    last_ping: Any
    _lock: Lock
    _host: Host
    _said: Callable[[str], None]
    _wire: Wire | None
    _since_s: float  # time.monotonic()
    _next_ping_s: float

    @classmethod
    def adopt(cls, connection: Any, lock: Lock, host: Host, said: Callable[[str], None]) -> None:
        """Make one of a connection that python-engineio has just made. Whoever closes one holds `lock`; `said`
        hears why somebody was hung up on."""
        connection.__class__ = cls
        connection.has_told, connection.waits = False, True
        connection._lock, connection._host, connection._said = lock, host, said
        connection._wire = None
        connection._since_s = connection._next_ping_s = time.monotonic()

    @property
    def is_by_websocket(self) -> bool:
        return bool(self.upgraded)

    @property
    def received_s(self) -> float:
        """`time.perf_counter()` when the last message had come; by long polling, now."""
        return time.perf_counter() if self._wire is None else self._wire.received_s

    def is_older_than(self, seconds: float) -> bool:
        return time.monotonic() - self._since_s >= seconds

    def waits_longer_than(self, seconds: float) -> bool:
        """Whether somebody by websocket has told no telemetry for so long, and was sent nothing for it."""
        return self.is_by_websocket and self.waits and not self.closed and self.is_older_than(seconds)

    def send_first(self, message: str) -> None:
        """Without being asked, and once."""
        self.waits = False
        self.send(packet.Packet(packet.MESSAGE, data=message))

    def send_now(self, message: str) -> bool:
        """Whether a websocket has taken the message; by long polling, nothing is sent but what is asked for."""
        if self._wire is None or not self.upgraded:
            return False
        self._wire.send(packet.Packet(packet.MESSAGE, data=message).encode())
        return True

    def tick(self) -> None:
        """Ping the client if it is time to, and close a connection whose client has gone."""
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
            return  # what came before it had heard of that
        self.has_told |= pkt.packet_type == packet.MESSAGE
        if pkt.packet_type == packet.PING:  # a modern client never sends one
            data = pkt.data if isinstance(pkt.data, str) else ""
            self.send(packet.Packet(packet.PONG, data=data[:MOST_ECHOED]))
        else:
            super().receive(pkt)

    def send(self, pkt: packet.Packet) -> None:
        """Returns at once: it is sent later, or fetched by a client that polls."""
        if self.queue.qsize() < MOST_UNREAD:
            super().send(pkt)
        elif not self.closing:
            self._said(NOT_READ)
            self.close(wait=False, abort=True)
            if self._wire is not None:
                self._wire.cut()

    def close(self, wait: bool = True, abort: bool = False, reason: str | None = None) -> None:
        if self._wire is not None and self._wire.broke:
            reason = self._wire.broke
        with self._lock:  # the tick closes too, and twice closed is twice reported
            super().close(wait=False, abort=abort, reason=reason)  # waiting, it would hold the lock

    def _upgrade_websocket(self, environ: dict[str, Any], start_response: Callable[..., Any]) -> Any:
        names = ("Host", "Upgrade", "Connection", "Sec-WebSocket-Key", "Sec-WebSocket-Version")
        told = {name: environ.get("HTTP_" + name.upper().replace("-", "_")) for name in names}
        headers = [(name, value) for name, value in told.items() if value is not None]
        stream = environ[STREAM]
        stream.settimeout(self.server.ping_interval + self.server.ping_timeout)
        try:
            wire = Wire(
                stream,
                headers,
                most_bytes=self.server.max_http_buffer_size,
                lock=self._host.make_lock(),
                give_way=self._host.give_way,
            )
        except WireError as error:
            self.close(wait=False, abort=True)
            return self.server._bad_request(str(error))
        self._wire = wire
        try:
            if not self.connected:  # it begins as a websocket: the greeting is sent before any answer
                for pkt in self.poll():
                    wire.send(pkt.encode())
            self._websocket_handler(wire)
        finally:
            wire.close()
            if wire.broke:
                self._said(HUNG_UP[wire.broke])
            environ[HAS_HUNG_UP] = True
        return []
