"""The listening socket: local unless asked otherwise, exclusive, and without the delayed acknowledgement."""

from __future__ import annotations

import socket
from typing import Any

from recorder.errors import ListenError
from recorder.green import eventlet


class QuickAckSocket(eventlet.greenio.GreenSocket):  # type: ignore[misc]
    """Acknowledges at once what it receives; what it accepts does so too.

    The real simulator sends a telemetry in many small writes with Nagle's algorithm on: each waits for the
    acknowledgement of the one before, which Linux delays. Measured: 44 ms a telemetry with the delay, 2.5 without.
    """

    def accept(self) -> tuple[QuickAckSocket, Any]:
        connection, address = super().accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return connection, address

    def recv(self, *arguments: Any, **options: Any) -> bytes:
        data: bytes = super().recv(*arguments, **options)
        if hasattr(socket, "TCP_QUICKACK"):  # Linux; the kernel switches it off again by itself
            self.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        return data


def listen(host: str, port: int) -> QuickAckSocket:
    """Listen on host:port, port 0 for a free one. Raises ListenError if that is not possible.

    Not `eventlet.listen`, which shares ports: a second server would silently take half of the connections.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = QuickAckSocket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen(16)
    except (OSError, OverflowError, TypeError, ValueError) as error:  # the latter two: no host has such a name
        listener.close()
        reason = getattr(error, "strerror", None) or error
        raise ListenError(
            f"cannot listen on {host}:{port} ({reason}); end the bc-drive or bc-record --listen that is running"
            " there, or give another --port"
        ) from None
    return listener
