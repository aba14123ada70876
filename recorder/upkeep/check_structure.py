"""Checks a log's file: every CRC, its indexes, lists and counts."""

from __future__ import annotations

import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Iterator

import numpy as np
from mcap.opcode import Opcode

from recorder.errors import LogError
from recorder.mcap.mcap_file import CHUNK_HEADER, MAGIC, RECORD, Chunk, McapFile, StoredMessage
from recorder.mcap.picture_places import (
    CHUNKS_ATTACHMENT,
    PICTURES_ATTACHMENT,
    is_about_places,
    places_in,
    read_chunk_crcs,
    stored_places,
)
from recorder.mcap.scan import DAMAGED, Structure
from recorder.upkeep.check_contents import Finding

ChunkMessages = tuple[bytes, list[StoredMessage]]  # the records of a chunk, and their messages


def sound_chunks(file: McapFile, structure: Structure, findings: list[Finding]) -> Iterator[ChunkMessages]:
    """Every sound chunk, in the file's order; faults are added to `findings`."""
    return (_without_end if structure.problem else _walk)(file, structure, findings)


def _without_end(file: McapFile, structure: Structure, findings: list[Finding]) -> Iterator[ChunkMessages]:
    """The chunks of a log without a readable end, which the search has checked."""
    if structure.problem != DAMAGED:
        findings.append(Finding("no readable end", structure.problem))
    for start, end in structure.lost:
        findings.append(Finding("unreadable bytes", f"{start:,} to {end:,}"))
    count = 0
    for chunk in structure.chunks:
        records = file.records(chunk)
        messages = list(file.messages(records))
        count += len(messages)
        file.check_count(count)
        yield records, messages


def _walk(file: McapFile, structure: Structure, findings: list[Finding]) -> Iterator[ChunkMessages]:
    """Read a finished log from its start, record by record; yields its sound chunks."""
    position, crc = len(MAGIC), zlib.crc32(MAGIC)
    indexed = {chunk.start: chunk for chunk in structure.chunks}
    places = PlacesCheck(file, structure, findings)
    counts: Counter[int] = Counter()
    expected: dict[int, list[tuple[int, int]]] = {}
    is_indexed = True  # other programs may write no indexes
    while True:
        try:
            opcode, length = RECORD.unpack(file.read(position, RECORD.size))
            record = file.read(position, RECORD.size + length)
        except LogError:
            findings.append(Finding("records of a wrong length", f"at byte {position:,}"))
            break
        if opcode != Opcode.MESSAGE_INDEX and expected:
            if is_indexed:
                findings.append(Finding("chunks without an index of their messages", f"before byte {position:,}"))
            expected = {}
        if opcode == Opcode.DATA_END:
            # no CRC covers this record's header; a later version of MCAP may add to the record
            if length != 4 and position + len(record) != structure.data_end:
                findings.append(Finding("records of a wrong length", f"at byte {position:,}"))
            (stored,) = struct.unpack("<I", record[RECORD.size :][:4].ljust(4, b"\0"))
            # 0 is damage, except in our earliest logs, which have neither this CRC nor bc.quality
            is_promised = file.promises_crcs and (structure.has_quality or not file.is_ours)
            if stored != crc and (stored or is_promised):
                findings.append(Finding("CRC of all data does not hold", f"{stored:08x}, found {crc:08x}"))
            break
        crc = zlib.crc32(record, crc)
        if opcode == Opcode.CHUNK:
            chunk = Chunk(position, position + len(record))
            listed = indexed.pop(position, chunk)
            if listed.end != chunk.end:
                findings.append(Finding("chunks with wrong places in the summary", f"at byte {position:,}"))
            try:
                records = file.unpacked(record, position)
                messages = list(file.messages(records))
                file.check_count(counts.total() + len(messages))
            except LogError:
                findings.append(Finding("damaged chunks", f"bytes {position:,} to {chunk.end:,}"))
            else:
                counts.update(message.channel for message in messages)
                expected = _index_of(messages)
                is_indexed = file.promises_crcs or listed.channels is not None
                _, _, first_ns, last_ns, _, _ = CHUNK_HEADER.unpack_from(record)
                times = [message.log_time_ns for message in messages] or [0]
                if (min(times), max(times)) != (first_ns, last_ns):
                    findings.append(Finding("chunks with wrong times in their headers", f"at byte {position:,}"))
                places.add(listed, record, {message.channel for message in messages})
                yield records, messages
        elif opcode == Opcode.MESSAGE and indexed.pop(position, None) is not None:  # of a file without chunks
            messages = list(file.messages(record))
            counts.update(message.channel for message in messages)
            yield record, messages
        elif opcode == Opcode.MESSAGE_INDEX and expected:
            is_indexed = True  # then every channel is
            channel, entries = _message_index(record)
            if sorted(entries) != sorted(expected.pop(channel, [])):
                findings.append(Finding("indexes that do not fit their chunk", f"at byte {position:,}"))
        position += len(record)
    findings.extend(
        Finding("chunks with wrong places in the summary", f"at byte {start:,}") for start in sorted(indexed)
    )
    # other programs may write no statistics
    stored_counts = structure.statistics.channel_message_counts if structure.statistics is not None else counts
    for channel in sorted(stored_counts.keys() | counts.keys()):
        if stored_counts.get(channel, 0) != counts[channel]:
            topic = structure.channels[channel].topic if channel in structure.channels else f"channel {channel}"
            where = f"{topic}: {counts[channel]:,} of {stored_counts.get(channel, 0):,}"
            findings.append(Finding("wrong message counts in the summary", where))


def _index_of(messages: list[StoredMessage]) -> dict[int, list[tuple[int, int]]]:
    """The expected index of each channel: (log time, offset of the record) of its messages."""
    index: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for message in messages:
        index[message.channel].append((message.log_time_ns, message.start))
    return index


def _message_index(record: bytes) -> tuple[int, list[tuple[int, int]]]:
    """Channel and entries of an index; (-1, []) for another record."""
    try:
        channel, size = struct.unpack_from("<HI", record, RECORD.size)
        return channel, list(struct.iter_unpack("<QQ", record[RECORD.size + 6 : RECORD.size + 6 + size]))
    except struct.error:
        return -1, []


class PlacesCheck:
    """Compares each chunk with its entry in the summary, and with the lists of chunks and pictures.

    Only our own logs have these lists, from version 0.2 on.
    """

    def __init__(self, file: McapFile, structure: Structure, findings: list[Finding]) -> None:
        self._findings = findings
        self._images = structure.image_channels
        self._numbers = {chunk.start: number for number, chunk in enumerate(structure.chunks)}
        self._crcs, self._places = None, None
        names = structure.attachment_names
        for at, name in sorted(names.items()):
            try:
                file.attachment(at)
            except LogError:
                findings.append(Finding("damaged attachments", f"{name} at byte {at:,}"))
        if not file.is_ours or not any(map(is_about_places, names.values())):
            return
        self._crcs = read_chunk_crcs(file, structure)
        if self._crcs is None:
            findings.append(Finding("lists that describe another file", CHUNKS_ATTACHMENT))
        elif (places := stored_places(file, structure)) is None:
            findings.append(Finding("lists that describe another file", PICTURES_ATTACHMENT))
        else:
            self._places = places
            # for all chunks together: a search for each chunk would copy the whole column
            self._edges = np.searchsorted(places["chunk"], np.arange(len(self._crcs) + 1)).tolist()

    def add(self, indexed: Chunk, record: bytes, channels: set[int]) -> None:
        """Check a sound chunk. `indexed`: its entry in the summary; `channels`: of its messages."""
        where = f"at byte {indexed.start:,}"
        if indexed.channels is not None and indexed.channels != channels:
            self._findings.append(Finding("chunks with wrong topics in the summary", where))
        if indexed.head and indexed.head != record[: len(indexed.head)]:
            self._findings.append(Finding("chunks with wrong times or sizes in the summary", where))
        number = self._numbers.get(indexed.start)
        if number is None or self._crcs is None:
            return
        *_, crc = CHUNK_HEADER.unpack_from(record)
        if self._crcs[number] != crc:
            self._findings.append(Finding("chunks with wrong CRCs in the list", where))
        if self._places is None or indexed.compression:
            return
        first, end = self._edges[number : number + 2]
        if self._places[first:end].tobytes() != places_in(record, number, self._images):
            self._findings.append(Finding("chunks with wrong pictures in the list", where))
