"""The server that simulators connect to, as Socket.IO clients: whatever they tell is answered by a handler."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import socketio

from recorder.broken_packets import CheckedPacket, hang_up_on_broken_packets, one_line_log
from recorder.green import eventlet
from recorder.listener import listen
from recorder.old_clients import accept_old_clients
from recorder.telemetry import MAX_IMAGE_BYTES, format_command

TICK_S = 0.1

Result = TypeVar("Result")


@dataclass(frozen=True)
class Steer:
    """A command to the simulator's car."""

    steering: float  # -1 (left) .. 1 (right)
    throttle: float  # -1..1
    decimal_comma: bool  # how the simulator's machine writes numbers


@dataclass(frozen=True)
class Answer:
    """The answer to one telemetry, and what is done when it has left."""

    command: Steer | None  # None is `manual`: a human drives
    then: Callable[[float], None]  # called with the milliseconds from the telemetry to its answer


class Handler(Protocol):
    """What is done with telemetry; `sid` names a connection. What it raises ends `TelemetryServer.run`."""

    def connected(self, sid: str) -> None: ...

    def disconnected(self, sid: str, reason: str) -> None: ...

    def telemetry(self, sid: str, data: object) -> Answer:
        """`data` is whatever the client has sent; None while a human holds a key."""
        ...

    def tick(self) -> None:
        """Called ten times a second, also while nothing arrives."""
        ...


class TelemetryServer:
    """Serves the real simulator and modern Socket.IO clients, any number of them, on one port."""

    def __init__(self, handler: Handler, *, host: str = "127.0.0.1", port: int = 4567) -> None:
        """Starts to listen; port 0 takes a free one. Raises ListenError if that is not possible."""
        self._handler = handler
        self._is_over = False
        self._failure: Exception | None = None
        self._steered: dict[str, bool] = {}  # the clients that were sent commands -> decimal commas
        self._listener = listen(host, port)
        self.port: int = self._listener.getsockname()[1]
        log = one_line_log()
        self._server = socketio.Server(
            async_mode="eventlet",
            async_handlers=False,
            serializer=CheckedPacket,
            logger=log,
            engineio_logger=log,
            # above it the connection is cut; a picture that is too large is answered first
            max_http_buffer_size=4 * MAX_IMAGE_BYTES,
        )
        self._server.on("connect", self._on_connect)
        self._server.on("disconnect", self._on_disconnect)
        self._server.on("telemetry", self._on_telemetry)
        accept_old_clients(self._server)
        self._application = hang_up_on_broken_packets(self._server)

    def run(self, until: Callable[[], bool]) -> None:
        """Serve until `until()` is true.

        Every car that was steered is then let roll out, and every connection closed. Raises what the handler
        raised.
        """
        web = eventlet.spawn(
            eventlet.wsgi.server,
            self._listener,
            self._application,
            environ={"wsgi.errors": eventlet.wsgi.LoggerNull()},  # sockets that were closed twice
            log_output=False,
            debug=False,  # a client is not shown tracebacks
        )
        try:
            while self._failure is None and not until():
                eventlet.sleep(TICK_S)  # a tick, because a signal does not wake eventlet
                self._call(self._handler.tick)
            self._is_over = True
            for sid, decimal_comma in list(self._steered.items()):
                self._steer(sid, Steer(0.0, 0.0, decimal_comma))  # the car keeps its last command
            eventlet.sleep(TICK_S)
        finally:
            self._is_over = True
            for connection in list(self._server.eio.sockets.values()):
                connection.close(wait=False)
            eventlet.sleep(0)
            web.kill()
            self._listener.close()
        if self._failure is not None:
            raise self._failure

    def _on_connect(self, sid: str, environ: dict[str, Any]) -> None:
        if not self._is_over:
            self._call(self._handler.connected, sid)

    def _on_disconnect(self, sid: str, reason: str) -> None:
        self._steered.pop(sid, None)
        if not self._is_over:
            self._call(self._handler.disconnected, sid, reason)

    def _on_telemetry(self, sid: str, data: object = None, *_: object) -> None:
        start_s = time.perf_counter()
        answer = None if self._is_over else self._call(self._handler.telemetry, sid, data)
        if answer is None:
            return
        if answer.command is None:
            self._server.emit("manual", {}, to=sid)
        else:
            self._steer(sid, answer.command)
        answered_ms = (time.perf_counter() - start_s) * 1e3
        self._server.sleep(0)  # the answer leaves now; writing it down comes after
        self._call(answer.then, answered_ms)

    def _steer(self, sid: str, command: Steer) -> None:
        self._steered[sid] = command.decimal_comma
        self._server.emit(
            "steer", format_command(command.steering, command.throttle, command.decimal_comma), to=sid
        )

    def _call(self, function: Callable[..., Result], *arguments: object) -> Result | None:
        """Call the handler. python-socketio would swallow its errors: they are kept, and end the run."""
        if self._failure is not None:
            return None
        try:
            return function(*arguments)
        except Exception as error:
            self._failure = error
            return None
