"""Ports for servers that are told theirs."""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
from collections.abc import Iterator
from typing import Final

_PORTS_EACH: Final = 1000


def free_ports(count: int) -> list[int]:
    """Ports on which nothing listens; another call gives others.

    They lie below those that the system gives to whoever asks for any, and each worker of pytest has its own: else
    somebody would be given one before the test takes it."""
    return list(itertools.islice(_FREE, count))


def _free() -> Iterator[int]:
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    first = 20_000 + worker % 12 * _PORTS_EACH
    for number in itertools.count(os.getpid()):  # several runs of the tests may share a machine
        port = first + number % _PORTS_EACH
        with contextlib.suppress(OSError):
            socket.create_server(("127.0.0.1", port)).close()
            yield port


_FREE: Final = _free()
