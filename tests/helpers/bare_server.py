"""A bare websocket server, to see on the wire what a client does; it says what the test says."""

from __future__ import annotations

import base64
import hashlib
import json
import socket
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Self

from tests.helpers.driving import PATIENCE_S

OPEN = '0{"sid":"x","upgrades":[],"pingInterval":25000,"pingTimeout":60000}'
GUID = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"  # RFC 6455


@dataclass
class Frame:
    is_last: bool
    opcode: int
    payload: bytes


class Hangup(Exception):  # noqa: N818
    """The client has closed the connection."""


@dataclass
class Wire:
    """The server's end of one connection, frame by frame (RFC 6455)."""

    stream: socket.socket
    request: str = ""
    frames: list[Frame] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)

    def shake_hands(self) -> None:
        while "\r\n\r\n" not in self.request:
            self.request += self._exactly(1).decode("ascii")
        key = next(
            line.split(": ")[1] for line in self.request.splitlines() if line.startswith("Sec-WebSocket-Key")
        )
        accept = base64.b64encode(hashlib.sha1((key + GUID).encode()).digest()).decode()
        head = "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        self.stream.sendall(f"{head}Sec-WebSocket-Accept: {accept}\r\n\r\n".encode())

    def say(self, message: str) -> None:
        data = message.encode()
        size = bytes([len(data)]) if len(data) < 126 else struct.pack(">BH", 126, len(data))
        self.stream.sendall(b"\x81" + size + data)

    def hear(self) -> str:
        """The next message, from however many frames; Hangup if there is none."""
        text = b""
        while True:
            frame = self._frame()
            if frame.opcode == 8:
                raise Hangup
            self.frames.append(frame)
            text += frame.payload
            if frame.is_last:
                self.messages.append(text.decode())
                return self.messages[-1]

    def hear_telemetry(self) -> str:
        """The next message that is a telemetry; heartbeats are answered on the way."""
        while not (message := self.hear()).startswith("42"):
            if message == "2":
                self.say("3")
        return message

    def _frame(self) -> Frame:
        first, second = self._exactly(2)
        size = second & 0x7F
        if size == 126:
            (size,) = struct.unpack(">H", self._exactly(2))
        elif size == 127:
            (size,) = struct.unpack(">Q", self._exactly(8))
        mask = self._exactly(4) if second & 0x80 else bytes(4)
        payload = bytes(byte ^ mask[i % 4] for i, byte in enumerate(self._exactly(size)))
        return Frame(bool(first & 0x80), first & 0x0F, payload)

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            part = self.stream.recv(count - len(data))
            if not part:
                raise Hangup
            data += part
        return data


class BareServer:
    """Calls one function for each connection, one after the other; the connection closes when it returns."""

    def __init__(self, *serve: Callable[[Wire], None]) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(PATIENCE_S)
        self.port: int = self._listener.getsockname()[1]
        self.wires: list[Wire] = []
        self._thread = threading.Thread(target=self._run, args=(serve,))
        self._thread.start()

    def _run(self, serve: tuple[Callable[[Wire], None], ...]) -> None:
        for function in serve:
            stream, _ = self._listener.accept()
            stream.settimeout(PATIENCE_S)
            wire = Wire(stream)
            self.wires.append(wire)
            with stream:
                try:
                    wire.shake_hands()
                    function(wire)
                except (Hangup, OSError):
                    pass
        self._listener.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._thread.join(PATIENCE_S)
        self._listener.close()


def steer(steering: object = "0.1000", throttle: object = "0.2000") -> str:
    return "42" + json.dumps(["steer", {"steering_angle": steering, "throttle": throttle}])
