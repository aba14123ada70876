"""The simulator's side of the Socket.IO protocol, byte for byte as in Udacity's Unity program.

From the code of the Unity client:

- It connects by websocket, and announces no Socket.IO connection (no `40`).
- It treats the server's `0{...}` as a second "open".
- It sends messages in websocket frames of at most 1016 bytes, with Nagle's algorithm on.
- It formats numbers as strings with four decimals.
- It answers each `steer` or `manual` with exactly one telemetry; a command that it cannot read, with none.
"""

from __future__ import annotations

import base64
import json
import math
import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import websocket
from websocket import ABNF

from common.car import MAX_STEERING_DEG, Camera
from common.location import shown_address

FRAME_BYTES: Final = 1016  # payload of one websocket frame (websocket-sharp's FragmentLength)
PING_S: Final = 25.0
CLOSE_S: Final = 3.0  # maximum wait for the server to close the connection
RETRY_S: Final = 0.05  # the Unity client retries without a delay, about 10,000 times a second


@dataclass(frozen=True)
class SimulatorTelemetry:
    steering: float  # -1 (left) .. 1 (right)
    throttle: float  # 0..1
    speed_mph: float
    jpeg: bytes  # of the centre camera; may also be a PNG
    world: Mapping[str, float] | None = None  # not sent by Udacity's simulator
    side_pictures: Mapping[Camera, bytes] = field(default_factory=dict)  # not sent by Udacity's simulator


@dataclass(frozen=True)
class SteerCommand:
    steering: float  # -1..1, not clamped
    throttle: float  # > 0 accelerates, < 0 brakes
    puts_back: bool = False  # a person requests to put the car back on the line; unknown to Udacity's simulator


ServerCommand = SteerCommand | Literal["manual"] | None
"""A message that requests a telemetry: a command, `manual`, or None when the connection has just opened."""

SimulatorMessage = SimulatorTelemetry | Literal["manual", "nothing"] | None
"""A message of the simulator: a telemetry; "manual" while a human holds a key; "nothing": only continue to listen;
None: quit."""


class WaitTimeoutError(Exception):
    """No server answered within the given time."""


class NoHostError(Exception):
    """The host is not a valid name or address, or cannot be resolved: waiting would not help."""


class SimulatorClient:
    """Runs the simulator's loop with a server. It reconnects by itself, as the Unity client does."""

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 4567,
        *,
        wait_s: float = 60.0,
        decimal_comma: bool = False,
        max_steering_deg: float = MAX_STEERING_DEG,
        in_flight: Literal[1, 2] = 2,
    ) -> None:
        """``wait_s`` is the maximum wait for a server. ``decimal_comma`` writes and reads numbers as a machine
        with this locale does. ``max_steering_deg`` is the angle of the wheels at steering 1. ``in_flight`` 2 sends
        the second telemetry before the first answer, as the Unity client does; 1 waits for each answer."""
        self._address = host.strip("[]"), port
        self.url = f"ws://{shown_address(*self._address)}/socket.io/?EIO=4&transport=websocket"
        self.wait_s = wait_s
        self.decimal_comma = decimal_comma
        self.max_steering_deg = max_steering_deg
        self.in_flight = in_flight
        self.telemetries = 0  # sent
        self.steers = 0  # received and readable
        self.manuals = 0  # received
        self.bad_steers = 0  # received and unreadable: not answered by a telemetry
        self.connections = 0

    def run(
        self,
        next_telemetry: Callable[[ServerCommand], SimulatorMessage],
        lost: Callable[[], object] = lambda: None,
    ) -> None:
        """Connect and drive until `next_telemetry` returns None. `lost` is called when the server has gone.

        `next_telemetry` is called when a connection opens, once for each telemetry in flight, and then once for
        each command.

        Raises NoHostError at once if the host does not exist, WaitTimeoutError if no server answers for `wait_s`.
        """
        while self._one_connection(self._connect(), next_telemetry):
            lost()

    def _connect(self) -> websocket.WebSocket:
        deadline_s = time.monotonic() + self.wait_s
        try:
            socket.getaddrinfo(*self._address, type=socket.SOCK_STREAM)
        except (OSError, ValueError) as error:
            why = error.strerror if isinstance(error, OSError) else "not the name of a machine"
            raise NoHostError(f"{self._address[0]}: {why}") from None
        while True:
            try:
                connection = websocket.create_connection(
                    self.url,
                    timeout=10,
                    suppress_origin=True,
                    sockopt=((socket.IPPROTO_TCP, socket.TCP_NODELAY, 0),),
                )
            except (ValueError, websocket.WebSocketAddressException) as error:  # an invalid address
                raise NoHostError(f"{self._address[0]}: {error}") from None
            except (OSError, websocket.WebSocketException):
                if time.monotonic() > deadline_s:
                    raise WaitTimeoutError(f"no server at {self.url} within {self.wait_s:g} s") from None
                time.sleep(RETRY_S)
            else:
                self.connections += 1
                return connection

    def _one_connection(
        self, connection: websocket.WebSocket, next_telemetry: Callable[[ServerCommand], SimulatorMessage]
    ) -> bool:
        """Drive until the server has gone (returns True: connect again) or everything is sent (returns False)."""
        commands: list[ServerCommand] = [None] * (self.in_flight - 1)  # the first of the two "open" events
        next_ping_s = time.monotonic()
        try:
            while True:
                for command in commands:
                    telemetry = next_telemetry(command)
                    if telemetry is None:
                        self._send(connection, "41")
                        self._send(connection, "1")
                        return False
                    if telemetry != "nothing":
                        self._send(connection, self._event(telemetry))
                        self.telemetries += 1
                if time.monotonic() >= next_ping_s:
                    self._send(connection, "2")
                    next_ping_s = time.monotonic() + PING_S
                commands = self._receive(connection, next_ping_s)
        except (OSError, websocket.WebSocketException):
            return True
        finally:
            self._close(connection)

    def _receive(self, connection: websocket.WebSocket, until_s: float) -> list[ServerCommand]:
        connection.settimeout(max(0.01, until_s - time.monotonic()))
        try:
            message = connection.recv()
        except websocket.WebSocketTimeoutException:
            return []
        if isinstance(message, bytes):
            message = message.decode("utf-8", "replace")
        if message.startswith("0"):
            return [None]  # the second "open"
        if message == "2":
            self._send(connection, "3")
        elif not message or message.startswith("1"):
            raise ConnectionResetError("the server has closed the connection")
        elif message.startswith("42"):
            return self._command(message[2:])
        return []  # "3", "40", "43": ignored

    def _command(self, payload: str) -> list[ServerCommand]:
        try:
            name, *arguments = json.loads(payload)
        except (ValueError, TypeError, RecursionError):
            return []
        if name == "manual":
            self.manuals += 1
            return ["manual"]
        if name != "steer":
            return []
        try:
            fields = arguments[0]
            steering, throttle = (self._number(fields[name]) for name in ("steering_angle", "throttle"))
            steer = SteerCommand(steering, throttle, fields.get("put_back") == "true")
        except (ValueError, TypeError, KeyError, IndexError):
            self.bad_steers += 1  # the Unity client catches its own exception, and sends no telemetry
            return []
        self.steers += 1
        return [steer]

    def _number(self, text: object) -> float:
        """Parse a number as .NET's float.Parse in the machine's culture: only strings, without thousands
        separators."""
        if not isinstance(text, str):
            raise TypeError("the Unity client expects strings")
        decimal, thousands = (",", ".") if self.decimal_comma else (".", ",")
        value = float(text.replace(thousands, "").replace(decimal, "."))
        if not math.isfinite(value):
            raise ValueError(text)
        return value

    def _event(self, telemetry: SimulatorTelemetry | Literal["manual"]) -> str:
        if telemetry == "manual":
            return '42["telemetry",null]'
        fields: dict[str, Any] = {
            "steering_angle": self._n4(telemetry.steering * self.max_steering_deg),
            "throttle": self._n4(telemetry.throttle),
            "speed": self._n4(telemetry.speed_mph),
            "image": base64.b64encode(telemetry.jpeg).decode("ascii"),
            **{
                f"image_{camera}": base64.b64encode(picture).decode("ascii")
                for camera, picture in telemetry.side_pictures.items()
            },
        }
        if telemetry.world is not None:
            fields["world"] = dict(telemetry.world)
        return f'42["telemetry",{json.dumps(fields, separators=(",", ":"))}]'

    def _n4(self, value: float) -> str:
        """Format a number as C#'s "N4": thousands separators and four decimals, in the machine's culture."""
        text = f"{value:,.4f}"
        return text.translate(str.maketrans(",.", ".,")) if self.decimal_comma else text

    @staticmethod
    def _close(connection: websocket.WebSocket) -> None:
        """Close a connection. The library's own `close` would suppress a Ctrl-C."""
        try:
            connection.settimeout(CLOSE_S)
            connection.send_close()
            while connection.recv_frame().opcode != ABNF.OPCODE_CLOSE:  # type: ignore[no-untyped-call]
                pass
        except (OSError, websocket.WebSocketException):
            pass  # the server has gone
        finally:
            connection.shutdown()  # type: ignore[no-untyped-call]

    @staticmethod
    def _send(connection: websocket.WebSocket, message: str) -> None:
        data = message.encode("utf-8")
        for start in range(0, len(data), FRAME_BYTES):
            opcode = ABNF.OPCODE_CONT if start else ABNF.OPCODE_TEXT
            is_last = int(start + FRAME_BYTES >= len(data))
            connection.send_frame(ABNF.create_frame(data[start : start + FRAME_BYTES], opcode, is_last))
