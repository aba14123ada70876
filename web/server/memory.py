"""The memory of the server: what a request has freed goes back to the system.

By default each of a server's forty threads gets an arena of its own, in which the C library keeps freed memory for
that thread, and Arrow keeps another pool. Both only ever grow to what all threads have needed at their worst.
"""

from __future__ import annotations

import ctypes
import sys
from typing import Final

import pyarrow as pa

# of glibc's malloc.h
_M_TRIM_THRESHOLD: Final = -1
_M_MMAP_THRESHOLD: Final = -3
_M_ARENA_MAX: Final = -8

_ARENAS: Final = 2
_LARGE_BYTES: Final = 256 << 10  # blocks of their own, which are given back when they are freed
_TRIM_BYTES: Final = 1 << 20  # free memory at the end of an arena


def give_memory_back() -> None:
    """Set this for the process, before it has threads. Without glibc, only Arrow's pool is set."""
    pa.set_memory_pool(pa.system_memory_pool())
    if sys.platform != "linux":
        return
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        for option, value in (
            (_M_ARENA_MAX, _ARENAS),
            (_M_MMAP_THRESHOLD, _LARGE_BYTES),
            (_M_TRIM_THRESHOLD, _TRIM_BYTES),
        ):
            set_option(option, value)
