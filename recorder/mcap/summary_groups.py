"""The summary of a long file in a store, without its list of chunks: of 8 GB, that is 3.4 MB, the rest a few KB.

The records of a summary lie in groups, one for each kind; the summary offset section behind them has their places
(https://mcap.dev/spec#summary-offset-section). The summary's CRC covers all of it: a part that is read alone is
checked by its own counts only.
"""

from __future__ import annotations

import struct
from typing import Final

from mcap.opcode import Opcode

from recorder.mcap.mcap_file import RECORD, McapFile

_OFFSET: Final = struct.Struct("<BQBQQ")  # opcode, length; opcode, start and length of a group
_MIN_BYTES: Final = 1 << 17
"""Of a list of chunks that is worth leaving out: so much of a file's end is read in one request."""


def read_without_chunks(file: McapFile, start: int, offsets_start: int, end: int) -> bytes | None:
    """The records of a summary from byte `start`, and the footer at byte `end`, but no chunk indexes; None where
    these are few, or their place is unknown. `offsets_start`: that of the summary offset section, 0 without one.
    Raises what `file.read` does."""
    if not start <= offsets_start <= end or (end - offsets_start) % _OFFSET.size or end - start < _MIN_BYTES:
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
    if size < _MIN_BYTES or begin < start or begin + size > offsets_start:
        return None
    return file.read(start, begin - start) + file.read(begin + size, file.size - begin - size)
