"""Unpacking the compressed chunks of an MCAP file."""

from __future__ import annotations

from typing import Final

import lz4.frame
import zstandard

NOT_UNPACKED: Final = (zstandard.ZstdError, RuntimeError, ValueError)  # the exceptions of `unpack`


def unpack(stored: bytes | memoryview, compression: bytes, size: int) -> bytes:
    """The unpacked bytes, at most one more than `size`. Raises NOT_UNPACKED."""
    match compression:
        case b"":
            return bytes(stored)
        case b"zstd":
            with zstandard.ZstdDecompressor().stream_reader(stored) as reader:
                return bytes(reader.read(size + 1))
        case b"lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=size + 1))
    raise ValueError(f"unknown compression {compression!r}")
