"""Which bytes of files are read."""

from __future__ import annotations

import os

import pytest


def note_reads(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """The bytes, from and to, that the operating system is asked for by their place in any file, from now on."""
    read: list[tuple[int, int]] = []
    pread = os.pread

    def noting(descriptor: int, length: int, offset: int) -> bytes:
        read.append((offset, offset + length))
        return pread(descriptor, length, offset)

    monkeypatch.setattr(os, "pread", noting)
    return read


def count_bytes(read: list[tuple[int, int]]) -> int:
    """Those that were read several times are counted as often."""
    return sum(end - start for start, end in read)
