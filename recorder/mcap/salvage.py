"""Finding what is whole in a damaged file, for a recovery.

Readers take the chunks that the summary lists. A recovery takes those whose CRC holds, and walks through the file
for chunks that are elsewhere.
"""

from __future__ import annotations

from recorder.errors import LogError
from recorder.mcap.mcap_file import Chunk, McapFile
from recorder.mcap.scan import Structure, walk


def salvage(file: McapFile, structure: Structure) -> None:
    """Leave in the structure of a finished file the chunks whose CRC holds, in the file's order, and list the
    others in its `lost`. The structure of an unfinished file lists only sound chunks already."""
    if structure.problem:
        return
    whole, damaged = list[Chunk](), list[tuple[int, int]]()
    for chunk in structure.chunks:
        try:
            file.parts(file.records(chunk))
        except LogError:
            damaged.append((chunk.start, chunk.end))
        else:
            whole.append(chunk)
    structure.chunks, structure.lost = whole, damaged
    if damaged:  # chunks may have moved
        walked = walk(file)
        starts = {chunk.start for chunk in whole}
        if moved := [chunk for chunk in walked.chunks if chunk.start not in starts]:
            structure.chunks = sorted(whole + moved, key=lambda chunk: chunk.start)
            structure.lost = walked.lost
            structure.metadata_at, structure.attachments_at = walked.metadata_at, walked.attachments_at
