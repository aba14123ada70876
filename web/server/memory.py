"""Memory that requests have freed goes back to the system.

By default, the C library keeps freed memory in an arena for each of the server's forty threads, and Arrow keeps it
in a pool. Both grow to the most that all threads ever needed.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from typing import Final

import anyio.to_thread
import pyarrow as pa
from starlette.types import ASGIApp, Receive, Scope, Send

EVERY: Final = 500
"""Number of answers after which free memory is given back."""

# of glibc's malloc.h
_M_MMAP_THRESHOLD: Final = -3
_M_ARENA_MAX: Final = -8
_ARENAS: Final = 2
_LARGE_BYTES: Final = 256 << 10  # separate blocks, which go back as soon as they are freed


def give_memory_back() -> None:
    """Make this process give it back, before it has threads. Without glibc, this sets only Arrow's pool."""
    pa.set_memory_pool(pa.system_memory_pool())
    if (set_option := _c_function("mallopt")) is not None:
        set_option(_M_ARENA_MAX, _ARENAS)
        set_option(_M_MMAP_THRESHOLD, _LARGE_BYTES)


def trim() -> None:
    """Give back free memory between used blocks."""
    if (trim_all := _c_function("malloc_trim")) is not None:
        trim_all(0)


class TrimmedApp:
    """An app that gives free memory back after every `EVERY` answers."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._answers = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        await self._app(scope, receive, send)
        self._answers += 1
        if self._answers % EVERY == 0:
            await anyio.to_thread.run_sync(trim)


def _c_function(name: str) -> Callable[..., int] | None:
    if sys.platform != "linux":
        return None
    return getattr(ctypes.CDLL(None), name, None)
