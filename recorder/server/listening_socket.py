"""The listening socket, which no other process shares."""

from __future__ import annotations

import errno
import selectors
import socket
from typing import Any

from common.location import shown_address
from recorder.errors import ListenError


def send_at_once(connection: socket.socket) -> None:
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def has_unread(stream: socket.socket) -> bool:
    """True if there is unread data, or the other side has hung up."""
    try:
        with selectors.DefaultSelector() as selector:
            selector.register(stream, selectors.EVENT_READ)
            return bool(selector.select(0))
    except (OSError, ValueError):  # closed
        return False


def listen(host: str, port: int, kind: type[Any] = socket.socket) -> Any:
    """A socket of class `kind` that listens on host:port; port 0 takes a free one. Raises ListenError if that
    fails.

    `eventlet.listen` shares ports: a second server would silently take half of the connections.
    """
    if not 0 <= port < 65536:
        raise ListenError(f"cannot listen on {shown_address(host, port)}: --port is a number from 1 to 65535")
    try:
        name = host.strip("[]") or None
        found = socket.getaddrinfo(name, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, *_, address = min(found, key=lambda one: one[0] != socket.AF_INET)  # IPv4, if a name has both
        listener = kind(family, socket.SOCK_STREAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
            listener.listen(16)
        except OSError:
            listener.close()
            raise
    except (OSError, ValueError) as error:  # ValueError: an invalid name of a host
        reason = getattr(error, "strerror", None) or error
        advice = "give an address of this machine by --host"
        if getattr(error, "errno", None) in (errno.EADDRINUSE, errno.EACCES):
            advice = "end the bc-drive or bc-record listen that is running there, or give another --port"
        raise ListenError(f"cannot listen on {shown_address(host, port)} ({reason}); {advice}") from None
    return listener
