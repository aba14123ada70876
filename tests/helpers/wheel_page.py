"""A page at a wheel, as a program: the same websocket, without a browser and bc-web between."""

from __future__ import annotations

import contextlib
import json
import struct
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from recorder.teleop.wheel import OpenWheel, open_wheels
from tests.helpers.waiting import PATIENCE_S


@dataclass(frozen=True)
class Shown:
    """A frame that was shown."""

    state: dict[str, Any]
    jpeg: bytes


class WheelPage:
    """Connected to the newest wheel of this folder, to `wheel`, or through bc-web to `address`."""

    def __init__(
        self, wheel: OpenWheel | None = None, address: str = "", headers: Mapping[str, str] | None = None
    ) -> None:
        if not address:
            wheel = wheel or open_wheels(Path.cwd())[0]
            address, headers = f"ws://127.0.0.1:{wheel.port}", {"Authorization": f"Bearer {wheel.token}"}
        self._address, self._headers = address, headers
        self._number = 0

    def send(self, kind: str, **values: object) -> None:
        self.socket.send(json.dumps({"type": kind, **values}))

    def steer(self, steering: float, throttle: float = 0.0, *, touching: bool = True, **values: object) -> int:
        """Send controls; their number."""
        self._number += 1
        self.send(
            "control",
            **{"device": "keyboard", "time_ms": 1000.0 * self._number, **values},
            number=self._number,
            steering=steering,
            throttle=throttle,
            touching=touching,
        )
        return self._number

    def text(self, kind: str) -> dict[str, Any]:
        """The next message of that kind; those before it are skipped, frames are acknowledged."""
        while True:
            message = self._next()
            if isinstance(message, dict) and message["type"] == kind:
                return message

    def frame(self) -> Shown:
        """The next frame, acknowledged."""
        while True:
            message = self._next()
            if isinstance(message, Shown):
                return message

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self.socket = stack.enter_context(
                connect(self._address, additional_headers=self._headers, compression=None, max_size=1 << 24)
            )
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _next(self) -> dict[str, Any] | Shown:
        data = self.socket.recv(PATIENCE_S)
        if isinstance(data, str):
            message: dict[str, Any] = json.loads(data)
            return message
        (length,) = struct.unpack_from(">I", data)
        state: dict[str, Any] = json.loads(data[4 : 4 + length])
        with contextlib.suppress(ConnectionClosed):  # the last messages may still come
            self.send("got", frame=state["frame"])
        return Shown(state, data[4 + length :])
