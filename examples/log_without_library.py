"""Prints the place of every picture in run.mcap, finished or not, without any library."""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

data = memoryview(Path("run.mcap").read_bytes())


def records(start: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of the content of each whole record."""
    while start + 9 <= end:
        opcode, length = struct.unpack_from("<BQ", data, start)
        if start + 9 + length > end:
            return  # it was still being written
        yield opcode, start + 9, start + 9 + length
        start += 9 + length


def picture(at: int, end: int) -> tuple[int, int]:
    """Offset and length of the field `data` (2) of a CompressedImage."""
    while at < end:
        field, at = data[at] >> 3, at + 1
        length = shift = 0
        while True:
            length |= (data[at] & 0x7F) << shift
            shift, at = shift + 7, at + 1
            if data[at - 1] < 0x80:
                break
        if field == 2:
            return at, length
        at += length
    raise ValueError("a CompressedImage without a picture")


topics: dict[int, str] = {}
for opcode, start, end in records(8, len(data)):
    if opcode != 0x06 or zlib.crc32(data[start + 40 : end]) != struct.unpack_from("<I", data, start + 24)[0]:
        continue  # no chunk, or a damaged one
    for opcode, at, until in records(start + 40, end):
        if opcode == 0x04:  # a channel
            channel, _, length = struct.unpack_from("<HHI", data, at)
            topics[channel] = bytes(data[at + 8 : at + 8 + length]).decode()
        elif opcode == 0x05:  # a message
            channel, row, time_ns, _ = struct.unpack_from("<HIQQ", data, at)
            if topics[channel].startswith("/camera/"):
                print(topics[channel], row, time_ns, *picture(at + 22, until))
