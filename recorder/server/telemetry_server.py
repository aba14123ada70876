"""The Socket.IO server for simulators. A handler answers each telemetry."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, Final, Literal, NamedTuple, Protocol, TypeVar
from urllib.parse import parse_qs

import socketio
from engineio.exceptions import EngineIOError
from engineio.socket import Socket
from socketio import packet

from common.errors import printable
from recorder.server.connection_guard import (
    END_S,
    MAX_CONNECTIONS,
    NOTICE_TOO_MANY,
    AllowedHosts,
    Notify,
    landing_page,
)
from recorder.server.eventlet_host import EventletHost, open_websocket
from recorder.server.in_flight import InFlight, RunningClock
from recorder.server.locale_numbers import POINT
from recorder.server.malformed_packets import CheckedPacket, check_body, is_telemetry, one_line_logger
from recorder.server.telemetry import MAX_IMAGE_BYTES, format_command
from recorder.server.websocket import NOTICES_BROKEN, HandshakeError, WebSocket

TICK_S: Final = 0.1
FIRST_COMMAND_S: Final = 1.0
"""The wait for telemetry before a first command is sent. The real simulator sends telemetry at once."""
NO_TELEMETRY_S: Final = 5.0  # a client without a message in this time speaks another protocol
MAX_MESSAGE_BYTES: Final = 4 * MAX_IMAGE_BYTES
"""Longer messages close the connection. Pictures that are only too large still fit, and are answered."""
MAX_UNREAD_PACKETS: Final = 64
"""The most packets that wait until a client reads them. Answers to a websocket's telemetry never wait."""

NOTICE_BROKEN: Final = (
    "disconnected a client that broke the Socket.IO protocol: a simulator in autonomous mode does not, other"
    " clients need python-socketio 5 or its like"
)
NOTICE_NOT_READING: Final = (
    "disconnected a client that does not read its messages: if it is your simulator, start it again"
)
NOTICE_NO_TELEMETRY: Final = (
    f"a client has opened a websocket and sent nothing for {NO_TELEMETRY_S:g} s: start the simulator's autonomous"
    " mode; other clients have to speak Socket.IO"
)
NOTICE_POLLING: Final = (
    "a client connects by long polling, which is slow: let it use a websocket (python-socketio's client does, once"
    " `pip install websocket-client` is done)"
)

NOTICE_REFUSED: Final = (
    "refused a web page or client that connects {}: use this machine's numeric address, or the name given with"
    " --host"
)
MAX_SHOWN_CHARACTERS: Final = 100  # of the refused name

Result = TypeVar("Result")


@dataclass(frozen=True)
class Steer:
    steering: float  # -1 (left) .. 1 (right)
    throttle: float  # -1..1
    decimal_separator: str = POINT  # of the simulator's machine
    puts_back: bool = False  # only for the built-in simulator


@dataclass(frozen=True)
class Answer:
    """The answer to one telemetry, and a callback for when it has been sent."""

    command: Steer | None  # None is `manual`: a human drives
    on_sent: Callable[[float], None]
    """Called when the system has taken the answer, or the client has gone, with the picture's age: milliseconds
    since the telemetry's last byte arrived."""


class Received(NamedTuple):
    sid: str
    data: object
    received_s: float


@dataclass
class Client:
    """A connected client. `connection` is python-engineio's."""

    connection: Socket
    connected_s: float = field(default_factory=time.monotonic)
    in_flight: InFlight[Received] = field(default_factory=InFlight)
    websocket: WebSocket | None = None  # None with long polling
    awaits_first_command: bool = True  # no telemetry has come, and no command was sent
    first_command_sent: bool = False  # before any telemetry

    @property
    def received_s(self) -> float:
        """`time.perf_counter()` when the last message had arrived; with long polling, now."""
        return time.perf_counter() if self.websocket is None else self.websocket.received_s

    @property
    def taken_s(self) -> float:
        """`time.perf_counter()` when the handling of the last message began; with long polling, now."""
        return time.perf_counter() if self.websocket is None else self.websocket.taken_s

    @property
    def has_unread(self) -> bool:
        return self.websocket is not None and (bool(self.websocket.waiting) or self.websocket.has_unread)

    @property
    def telemetries(self) -> int:
        """The number of telemetries that were read, but not handled yet."""
        return 0 if self.websocket is None else sum(map(is_telemetry, self.websocket.waiting))

    def is_older_than(self, seconds: float) -> bool:
        return time.monotonic() - self.connected_s >= seconds


class TelemetryHandler(Protocol):
    """Answers telemetry; `sid` names a connection. The server's thread calls it. Its exceptions end
    `TelemetryServer.run`."""

    def connected(self, sid: str) -> None: ...

    def disconnected(self, sid: str, reason: str) -> None: ...

    def telemetry(self, sid: str, data: object, received_s: float) -> Answer:
        """The answer to `data`: anything that the client sent; None while a human holds a key. `received_s`: the
        `time.perf_counter()` when its handling began, perhaps after a wait."""
        ...

    def unanswered(self, sid: str, data: object, received_s: float) -> None:
        """Called with a telemetry that is left unanswered, because too many are in flight
        (`recorder.server.in_flight`), or because its client has gone. Its last byte arrived at `received_s`."""
        ...

    def first_command_sent(self, sid: str) -> None:
        """Called before the first telemetry of a client, if it got a first command before."""
        ...

    def tick(self) -> None:
        """Called ten times a second, also if nothing arrives."""
        ...

    def final_command(self, sid: str) -> Steer | None:
        """The last command to a steered client at the end of a run, also of a failed one; None sends nothing. The
        simulator's car keeps this command."""
        ...


class TelemetryServer:
    """Serves the real simulator and modern Socket.IO clients on one port."""

    def __init__(
        self,
        handler: TelemetryHandler,
        *,
        host: str = "127.0.0.1",
        port: int = 4567,
        notify: Notify = lambda text: None,
        first_command: Steer | Literal["manual", "nothing"] = "nothing",
    ) -> None:
        """Starts to listen; port 0 takes a free one. Raises ListenError if that fails.

        `notify` gets a line about other clients than simulators, each line once. `first_command` is sent if no
        telemetry has come on a websocket for `FIRST_COMMAND_S`: some clients wait for the command with which
        classic servers begin.
        """
        self._first_command = first_command
        self._handler = handler
        self._notify = notify
        self._notified: set[str] = set()
        self._is_over = False
        self._failure: Exception | None = None
        self._steered: set[str] = set()  # the clients that were sent commands
        self._unsent_answers = 0
        self._clock = RunningClock()
        self._allowed_hosts = AllowedHosts(host)
        self._has_refused = False
        self._host = EventletHost(host, port, self._notify_once)
        self.port: int = self._host.port
        log = one_line_logger(self._notify_once)
        self._server = socketio.Server(
            async_mode="eventlet",
            async_handlers=False,
            serializer=CheckedPacket,
            cors_allowed_origins=self._allowed_hosts.allows,
            logger=log,
            engineio_logger=log,
            max_http_buffer_size=MAX_MESSAGE_BYTES,
            monitor_clients=False,  # the tick does
        )
        self._server.on("connect", self._on_connect)
        self._server.on("disconnect", self._on_disconnect)
        self._server.on("telemetry", self._on_telemetry)
        self._application = socketio.WSGIApp(self._server, landing_page(self._notify_once))
        self._clients: dict[str, Client] = {}  # by python-engineio's names
        self._engine = self._server.eio
        # python-engineio finds here what serves websockets: ours, instead of eventlet's
        self._engine._async = {**self._engine._async, "websocket": self._upgrade}
        self._connected, self._received = (self._engine.handlers[name] for name in ("connect", "message"))
        self._engine.on("connect", self._on_connection)
        self._engine.on("message", self._on_message)

    def run(self, until: Callable[[], bool]) -> None:
        """Serve until `until()` is true; the server's thread calls it.

        At the end, every steered client gets its `TelemetryHandler.final_command`, and every connection is closed.
        Raises the handler's exceptions.
        """
        self._host.start(self._serve)
        try:
            while self._failure is None and not until():
                self._host.wait(TICK_S)  # a tick, because a signal does not wake eventlet
                self._clock.tick()
                self._call(self._handler.tick)
                self._tick_clients()
        finally:
            for client in list(self._clients.values()):
                self._release_held(client)
            self._is_over = True
            until_s = time.monotonic() + END_S  # other green threads still send: the car keeps the last command
            while self._unsent_answers and time.monotonic() < until_s:
                self._host.wait(0.01)
            for sid in list(self._steered):
                self._stop(sid)
            for client in list(self._clients.values()):
                client.connection.close(wait=False)
            self._host.end()
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """Stop listening; `run` does so at its end."""
        self._host.close()

    def push(self, sid: str, command: Steer) -> None:
        """Send a command that answers no telemetry. The handler may call it in `tick`."""
        if (client := self._client(sid)) is not None:
            client.in_flight.pushed(self._clock.tick())
            self._steered.add(sid)
            self._server.emit(*_event(command), to=sid)

    def in_flight(self, sid: str) -> int:
        """The least number of telemetries of a client in flight."""
        client = self._client(sid)
        return 1 if client is None else client.in_flight.count

    def has_unread(self, sid: str) -> bool:
        """True if data of a client has not reached the handler yet: the client is not silent."""
        client = self._client(sid)
        return client is not None and (client.has_unread or client.in_flight.holds)

    def _client(self, sid: str) -> Client | None:
        is_connected = self._server.manager.is_connected(sid, "/")
        return self._clients.get(self._server.manager.eio_sid_from_sid(sid, "/")) if is_connected else None

    def _stop(self, sid: str) -> None:
        try:
            command = self._handler.final_command(sid)
        except Exception as error:
            self._failure = self._failure or error
        else:
            if command is not None:
                self.push(sid, command)

    def _serve(self, environ: dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
        if refused := self._allowed_hosts.why_refused(environ):
            if not self._has_refused:  # once: a page that tries many names must not fill the screen
                self._has_refused = True
                self._notify_once(NOTICE_REFUSED.format(printable(refused[:MAX_SHOWN_CHARACTERS])))
            start_response("403 Forbidden", [("Content-Length", "0")])
            return []
        try:
            check_body(environ)
            answer: Iterable[bytes] = self._application(environ, start_response)
            return answer
        except Exception:  # not even Engine.IO
            start_response("400 Bad Request", [("Content-Length", "0")])
            return []

    def _upgrade(self, handle: Any, _: object) -> Callable[..., Iterable[bytes]]:
        """The web application that python-engineio calls for a websocket. `handle` serves the open websocket."""

        def serve(environ: dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
            connection: Socket = handle.__self__
            timeout_s = self._engine.ping_interval + self._engine.ping_timeout
            try:
                websocket = open_websocket(environ, max_bytes=MAX_MESSAGE_BYTES, timeout_s=timeout_s)
            except (HandshakeError, OSError):
                connection.close(wait=False, abort=True)
                raise
            self._clients[connection.sid].websocket = websocket

            def give_reason() -> None:  # python-engineio would name none
                if websocket.broken_by:
                    self._notify_once(NOTICES_BROKEN[websocket.broken_by])
                    connection.close(wait=False, abort=True, reason=websocket.broken_by)

            websocket.before_end = give_reason
            try:
                handle(websocket)
            except Exception:  # not Engine.IO
                self._hang_up(connection)
            finally:
                websocket.close()
                connection.close(wait=False, abort=True)
            return []

        return serve

    def _hang_up(self, connection: Socket) -> None:
        """Close the connection: its client broke the protocol."""
        if not connection.closed:
            self._notify_once(NOTICE_BROKEN)
            connection.close(wait=False, reason="broken packet")

    def _on_connection(self, engine_sid: str, environ: dict[str, Any]) -> Any:
        transport = parse_qs(str(environ.get("QUERY_STRING", ""))).get("transport", [""])[0]
        if transport != "websocket" and len(self._engine.sockets) > MAX_CONNECTIONS:
            # the host counts websockets; polling clients have no open connection
            self._notify_once(NOTICE_TOO_MANY)
            return False
        self._clients[engine_sid] = Client(self._engine.sockets[engine_sid])
        return self._connected(engine_sid, environ)

    def _on_message(self, engine_sid: str, data: str | bytes) -> None:
        client = self._clients.get(engine_sid)
        if client is None or client.connection.closed:
            return  # the client did not know this yet
        try:
            self._received(engine_sid, data)
        except Exception:  # its parser raises nearly anything; handlers' errors are caught before
            self._hang_up(client.connection)

    def _on_connect(self, sid: str, environ: dict[str, Any]) -> None:
        if not self._is_over:
            self._call(self._handler.connected, sid)

    def _on_disconnect(self, sid: str, reason: str) -> None:
        self._steered.discard(sid)
        if not self._is_over:
            self._release_held(self._clients[self._server.manager.eio_sid_from_sid(sid, "/")])
            self._call(self._handler.disconnected, sid, reason)

    def _on_telemetry(self, sid: str, data: object = None, *_: object) -> None:
        client = self._clients[self._server.manager.eio_sid_from_sid(sid, "/")]
        client.awaits_first_command = False
        if self._is_over:
            return
        if client.first_command_sent:
            client.first_command_sent = False
            self._call(self._handler.first_command_sent, sid)
        received = Received(sid, data, client.received_s)
        unanswered, due = client.in_flight.take(received, client.telemetries, self._clock.tick())
        for telemetry in unanswered:
            self._call(self._handler.unanswered, *telemetry)
        if due is not None and (answer := self._answer(due, client.taken_s)) is not None:
            self._send(answer, due, client)

    def _send(self, answer: Answer, received: Received, client: Client) -> None:
        self._unsent_answers += 1
        if client.websocket is not None:
            client.websocket.look()  # telemetry that arrives before the answer leaves does not answer it
        waiting = client.telemetries
        with contextlib.suppress(OSError, EngineIOError):  # the client has gone
            if client.websocket is None:
                self._server.emit(*_event(answer.command), to=received.sid)
            else:
                client.websocket.send(_message(answer.command))
        total_ms = (time.perf_counter() - received.received_s) * 1e3
        self._unsent_answers -= 1
        client.in_flight.answered(waiting)
        self._call(answer.on_sent, total_ms)

    def _answer(self, received: Received, taken_s: float) -> Answer | None:
        """The handler's answer; None if it has failed."""
        answer = self._call(self._handler.telemetry, received.sid, received.data, taken_s)
        if answer is not None and answer.command is not None:
            self._steered.add(received.sid)
        return answer

    def _answer_held(self, client: Client) -> None:
        flight = client.in_flight
        received = flight.overdue(self._clock.seconds, has_unread=client.has_unread) if flight.holds else None
        if received is not None and (answer := self._answer(received, time.perf_counter())) is not None:
            self._server.emit(*_event(answer.command), to=received.sid)
            self._call(answer.on_sent, (time.perf_counter() - received.received_s) * 1e3)

    def _release_held(self, client: Client) -> None:
        """Give the handler the held telemetry of a client that will get no answer."""
        if (received := client.in_flight.release()) is not None:
            self._call(self._handler.unanswered, *received)

    def _tick_clients(self) -> None:
        for engine_sid, client in list(self._clients.items()):
            connection = client.connection
            if not connection.closed and connection.queue.qsize() > MAX_UNREAD_PACKETS:
                self._notify_once(NOTICE_NOT_READING)
                connection.close(wait=False, abort=True)
                if client.websocket is not None:
                    client.websocket.cut()
            if connection.closed or not connection.check_ping_timeout():
                del self._clients[engine_sid]
                self._engine.sockets.pop(engine_sid, None)
                continue
            self._answer_held(client)
            self._send_first_command(client)
            if client.is_older_than(NO_TELEMETRY_S):
                if client.websocket is None:
                    self._notify_once(NOTICE_POLLING)
                elif not client.websocket.taken_s:
                    self._notify_once(NOTICE_NO_TELEMETRY)

    def _send_first_command(self, client: Client) -> None:
        """Send a websocket's first command if no telemetry has come in time."""
        if self._first_command == "nothing" or client.websocket is None or not client.awaits_first_command:
            return
        if client.is_older_than(FIRST_COMMAND_S):
            client.awaits_first_command, client.first_command_sent = False, True
            client.in_flight.pushed(self._clock.seconds)
            command = self._first_command if isinstance(self._first_command, Steer) else None
            with contextlib.suppress(OSError):
                client.websocket.send(_message(command))

    def _notify_once(self, text: str) -> None:
        if text not in self._notified:
            self._notified.add(text)
            self._call(self._notify, text)

    def _call(self, function: Callable[..., Result], *arguments: object) -> Result | None:
        """Call the handler. Keep its exceptions, which python-socketio would hide: they end the run."""
        if self._failure is not None:
            return None
        try:
            return function(*arguments)
        except Exception as error:
            self._failure = error
            return None


def _event(command: Steer | None) -> tuple[str, dict[str, str]]:
    if command is None:
        return "manual", {}
    fields = format_command(command.steering, command.throttle, command.decimal_separator)
    return "steer", fields | ({"put_back": "true"} if command.puts_back else {})


def _message(command: Steer | None) -> str:
    return "4" + str(packet.Packet(packet.EVENT, data=[*_event(command)]).encode())
