"""The Socket.IO server for simulators. A handler answers each telemetry."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final, Literal, Protocol, TypeVar
from urllib.parse import parse_qs

import socketio
from engineio.exceptions import EngineIOError
from socketio import packet

from common.errors import printable
from recorder.server.allowed_hosts import AllowedHosts
from recorder.server.connection_guard import END_S, MAX_CONNECTIONS, NOTICE_TOO_MANY, Notify, landing_page
from recorder.server.engineio_connection import Connection, Received
from recorder.server.eventlet_host import EventletHost
from recorder.server.in_flight import RunningClock
from recorder.server.locale_numbers import POINT
from recorder.server.malformed_packets import CheckedPacket, check_body, is_telemetry, one_line_logger
from recorder.server.telemetry import MAX_IMAGE_BYTES, format_command

TICK_S: Final = 0.1
FIRST_COMMAND_S: Final = 1.0
"""The wait for telemetry before a first command is sent. The real simulator sends telemetry at once."""
NO_TELEMETRY_S: Final = 5.0  # a client without a message in this time speaks another protocol
MAX_MESSAGE_BYTES: Final = 4 * MAX_IMAGE_BYTES
"""Longer messages close the connection. Pictures that are only too large still fit, and are answered."""

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
_SID: Final = "telemetry.sid"  # the key of a connection's name in its request's environment

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
        self._engine = self._server.eio
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
                self._tick_connections()
        finally:
            for connection in list(self._engine.sockets.values()):
                self._release_held(connection)
            self._is_over = True
            until_s = time.monotonic() + END_S  # other green threads still send: the car keeps the last command
            while self._unsent_answers and time.monotonic() < until_s:
                self._host.wait(0.01)
            for sid in list(self._steered):
                self._stop(sid)
            for connection in list(self._engine.sockets.values()):
                connection.close(wait=False)
            self._host.end()
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """Stop listening; `run` does so at its end."""
        self._host.close()

    def push(self, sid: str, command: Steer) -> None:
        """Send a command that answers no telemetry. The handler may call it in `tick`."""
        if (connection := self._connection(sid)) is not None:
            connection.in_flight.pushed(self._clock.tick())
            self._steered.add(sid)
            self._server.emit(*_event(command), to=sid)

    def in_flight(self, sid: str) -> int:
        """The least number of telemetries of a client in flight."""
        connection = self._connection(sid)
        return 1 if connection is None else connection.in_flight.count

    def has_unread(self, sid: str) -> bool:
        """True if data of a client has not reached the handler yet: the client is not silent."""
        connection = self._connection(sid)
        return connection is not None and (connection.has_unread or connection.in_flight.holds)

    def _connection(self, sid: str) -> Connection | None:
        is_connected = self._server.manager.is_connected(sid, "/")
        return self._engine.sockets.get(self._server.manager.eio_sid_from_sid(sid, "/")) if is_connected else None

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
            if (connection := self._engine.sockets.get(environ.get(_SID))) is not None:
                connection.hang_up()
            start_response("400 Bad Request", [("Content-Length", "0")])
            return []

    def _on_connection(self, engine_sid: str, environ: dict[str, Any]) -> Any:
        transport = parse_qs(str(environ.get("QUERY_STRING", ""))).get("transport", [""])[0]
        if transport != "websocket" and len(self._engine.sockets) > MAX_CONNECTIONS:
            # the host counts websockets; polling clients have no open connection
            self._notify_once(NOTICE_TOO_MANY)
            return False
        Connection.adopt(self._engine.sockets[engine_sid], self._notify_once)
        environ[_SID] = engine_sid
        return self._connected(engine_sid, environ)

    def _on_message(self, engine_sid: str, data: str | bytes) -> None:
        connection: Connection = self._engine.sockets[engine_sid]
        connection.hand_over(data, self._received)

    def _on_connect(self, sid: str, environ: dict[str, Any]) -> None:
        if not self._is_over:
            self._call(self._handler.connected, sid)

    def _on_disconnect(self, sid: str, reason: str) -> None:
        self._steered.discard(sid)
        if not self._is_over:
            self._release_held(self._engine.sockets[self._server.manager.eio_sid_from_sid(sid, "/")])
            self._call(self._handler.disconnected, sid, reason)

    def _on_telemetry(self, sid: str, data: object = None, *_: object) -> None:
        connection: Connection = self._engine.sockets[self._server.manager.eio_sid_from_sid(sid, "/")]
        connection.awaits_first_command = False
        if self._is_over:
            return
        if connection.first_command_sent:
            connection.first_command_sent = False
            self._call(self._handler.first_command_sent, sid)
        received = Received(sid, data, connection.received_s)
        unanswered, due = connection.in_flight.take(received, _telemetries(connection), self._clock.tick())
        for telemetry in unanswered:
            self._call(self._handler.unanswered, *telemetry)
        if due is not None and (answer := self._answer(due, connection.taken_s)) is not None:
            self._send(answer, due, connection)

    def _send(self, answer: Answer, received: Received, connection: Connection) -> None:
        self._unsent_answers += 1
        connection.look()  # telemetry that arrives before the answer leaves does not answer it
        waiting = _telemetries(connection)
        name, fields = _event(answer.command)
        with contextlib.suppress(OSError, EngineIOError):  # the client has gone
            if not connection.send_directly(packet.Packet(packet.EVENT, data=[name, fields]).encode()):
                self._server.emit(name, fields, to=received.sid)
        total_ms = (time.perf_counter() - received.received_s) * 1e3
        self._unsent_answers -= 1
        connection.in_flight.answered(waiting)
        self._call(answer.on_sent, total_ms)

    def _answer(self, received: Received, taken_s: float) -> Answer | None:
        """The handler's answer; None if it has failed."""
        answer = self._call(self._handler.telemetry, received.sid, received.data, taken_s)
        if answer is not None and answer.command is not None:
            self._steered.add(received.sid)
        return answer

    def _answer_held(self, connection: Connection) -> None:
        flight = connection.in_flight
        received = flight.overdue(self._clock.seconds, has_unread=connection.has_unread) if flight.holds else None
        if received is not None and (answer := self._answer(received, time.perf_counter())) is not None:
            self._server.emit(*_event(answer.command), to=received.sid)
            self._call(answer.on_sent, (time.perf_counter() - received.received_s) * 1e3)

    def _release_held(self, connection: Connection) -> None:
        """Give the handler the held telemetry of a client that will get no answer."""
        if (received := connection.in_flight.release()) is not None:
            self._call(self._handler.unanswered, *received)

    def _tick_connections(self) -> None:
        for engine_sid, connection in list(self._engine.sockets.items()):
            connection.tick()
            self._answer_held(connection)
            if connection.closed and not connection.is_websocket:
                self._engine.sockets.pop(engine_sid, None)
                continue
            if self._first_command != "nothing" and connection.has_waited(FIRST_COMMAND_S):
                event = _event(self._first_command if isinstance(self._first_command, Steer) else None)
                connection.send_first_command(
                    packet.Packet(packet.EVENT, data=[*event]).encode(), self._clock.seconds
                )
            if connection.is_older_than(NO_TELEMETRY_S):
                if not connection.is_websocket:
                    self._notify_once(NOTICE_POLLING)
                elif not connection.has_sent_message:
                    self._notify_once(NOTICE_NO_TELEMETRY)

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


def _telemetries(connection: Connection) -> int:
    """The number of telemetries that were read, but not handled yet."""
    return sum(map(is_telemetry, connection.waiting))
