"""Settings of the C library's memory allocator."""

from __future__ import annotations

import ctypes
import os
import sys
from typing import Final

# mallopt(3), malloc.h
_M_TRIM_THRESHOLD: Final = -1
_M_MMAP_THRESHOLD: Final = -3

_MAX_BLOCK_BYTES: Final = 1 << 30
_MAX_KEPT_BYTES: Final = (1 << 31) - 1


def keep_freed_memory() -> None:
    """Let the C library keep freed memory for later allocations, up to 2 GiB.

    By itself, glibc gives every block of more than 32 MiB back, and the system hands out fresh pages, each of them
    zeroed on its first touch. What the first layers give is of that size. Measured on 2 cores, bfloat16, 64
    pictures at once: 165,000 page faults and 0.79 s a batch of 256, against none and 0.57 s. Other C libraries
    have no such threshold: nothing is done there.
    """
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _MAX_BLOCK_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _MAX_KEPT_BYTES)


def use_large_pages() -> None:
    """Let PyTorch ask Linux for pages of 2 MiB, where this process has not imported it yet.

    A training step in float32 took 3.5 % less processor time, with the same results, and 0.1 GB more
    memory (Intel Xeon without AMX).
    """
    os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")
