"""The summary of a long file in a store, without its list of chunks: of 8 GB, that is 3.4 MB, the rest a few KB.

The records of a summary lie in groups, one for each kind, and behind them it says where each group lies
(https://mcap.dev/spec#summary-offset-section). The summary's CRC covers all of it: what is read alone is
compared with nothing but the counts that it tells itself.
"""

from __future__ import annotations

import struct
from typing import Final

from mcap.opcode import Opcode

from recorder.log.mcap_file import RECORD, McapFile

_OFFSET: Final = struct.Struct("<BQBQQ")  # opcode, length; opcode, start and length of a group
_LEAST_BYTES: Final = 1 << 17
"""Of a list of chunks that is worth leaving out: so much of a file's end is read in one request."""


def read_without_chunks(file: McapFile, start: int, offsets_start: int, end: int) -> bytes | None:
    """The records of a summary from byte `start`, and the footer at byte `end`, but no chunk indexes; None where
    these are few, or nothing tells where they are. `offsets_start`: where it begins to say so, 0 if it does not.
    Raises what `file.read` does."""
    if not start <= offsets_start <= end or (end - offsets_start) % _OFFSET.size or end - start < _LEAST_BYTES:
        return None
    offsets = list(_OFFSET.iter_unpack(file.read(offsets_start, end - offsets_start)))
    if any(
        (opcode, length) != (Opcode.SUMMARY_OFFSET, _OFFSET.size - RECORD.size) for opcode, length, *_ in offsets
    ):
        return None
    groups = [(begin, size) for _, _, kind, begin, size in offsets if kind == Opcode.CHUNK_INDEX]
    if len(groups) != 1:
        return None
    begin, size = groups[0]
    if size < _LEAST_BYTES or begin < start or begin + size > offsets_start:
        return None
    return file.read(start, begin - start) + file.read(begin + size, file.size - begin - size)
