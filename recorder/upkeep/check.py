"""Checks a log: its file (every CRC, its indexes, lists and counts) and its contents."""

from __future__ import annotations

import contextlib
import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode

from common.location import Location
from common.process_settings import usable_cores
from common.progress import track
from recorder.errors import LogError
from recorder.log.known_lag import find_lag
from recorder.log.reader import Log
from recorder.log.road_places import states_of
from recorder.log.tags import EXCLUDE, TaggedRows, fine_rows, read_tags
from recorder.mcap.mcap_file import CHUNK_HEADER, MAGIC, RECORD, Chunk, McapFile, StoredMessage
from recorder.mcap.picture_places import (
    CHUNKS_ATTACHMENT,
    PICTURES_ATTACHMENT,
    is_about_places,
    places_in,
    read_chunk_crcs,
    stored_places,
)
from recorder.mcap.scan import DAMAGED, Structure, read_structure
from recorder.rows.label_plan import wrong_timing
from recorder.rows.odd_stretches import OddStretch, odd_stretches
from recorder.rows.steering_habits import LagFinding
from recorder.topics import POSE, VEHICLE, camera_topic
from recorder.upkeep.check_contents import GAPS, Contents, Finding, odd_findings

ChunkMessages = tuple[bytes, list[StoredMessage]]  # the records of a chunk, and their messages


def is_whole(path: Location) -> bool:
    """True for a finished file with every byte sound. Raises LogError for other files than MCAP's."""
    findings: list[Finding] = []
    with McapFile(path) as file:
        structure = read_structure(file)
        if structure.problem:
            return False
        chunks = sound_chunks(file, structure, findings)
        for _ in track(chunks, f"checking {path.name}", len(structure.chunks)):
            if findings:
                break
    return not findings


@dataclass(frozen=True)
class Checked:
    path: Location
    messages: int
    pictures: int  # decoded
    findings: list[Finding]
    is_damaged: bool  # the file itself
    has_crcs: bool  # other programs may write none: then damage is not noticed
    meant_gaps: list[str]  # gaps in time that its events explain; not findings
    pauses: list[str]  # of a recorder that people switch off and on; not findings
    set_back: list[str]  # jumps back in time; of such a recorder, not findings
    lag: LagFinding | None  # of the steering, known or measured; None: not measured
    odd: list[OddStretch]  # without those tagged fine; including unsure ones, which are not findings


def check(path: Location, *, look: bool = True) -> Checked:
    """Read the whole log at `path` and report its faults. `look` decodes every picture.

    File: every CRC, the indexes and the counts. Contents: rows out of order, broken and frozen pictures, rows
    without a picture and pictures without a row, gaps, stuck steering, values out of range. With `look`, also the
    steering's lag, which is kept next to the log, and, for a log on this machine, swapped side cameras and
    steering that contradicts the pictures. Raises LogError for other files than MCAP's.
    """
    damage: list[Finding] = []
    findings: list[Finding] = []
    fine = fine_rows(path)
    with McapFile(path) as file:
        structure = read_structure(file)
        with ThreadPoolExecutor(usable_cores()) as pool:
            contents = Contents(structure, findings, pool if look else None, path, is_ours=file.is_ours, fine=fine)
            chunks = sound_chunks(file, structure, damage)
            for records, messages in track(chunks, f"checking {path.name}", len(structure.chunks)):
                for message in messages:
                    contents.add(records, message)
            contents.finish()
        has_crcs = file.have_crcs(structure.chunks)
    has_rows = contents.counts[VEHICLE] and contents.counts[camera_topic("center")]
    odd = contents.odd
    lag = None
    excluded = TaggedRows(())
    is_paused_by_people = False
    with contextlib.suppress(LogError), Log(path) as log:
        # people switch these recorders off and on: a gap is not a loss
        is_paused_by_people = log.metadata.get("source") in ("udacity", "donkeycar", "csv")
        excluded = TaggedRows(read_tags(path, log.fingerprint), EXCLUDE)
        states = states_of(log) if contents.counts[POSE] else None
        if states is not None:
            odd = odd_stretches(states)
        if look and has_rows:
            lag = find_lag(log)
        shown = None if lag is None else lag.lag
        if look and has_rows and isinstance(path, Path):
            from recorder.log.known_lag import measure_lag
            from recorder.seen.picture_stretches import with_pictures  # OpenCV
            from recorder.upkeep.swapped_cameras import same_pictures, swapped_cameras

            if states is None:
                states = states_of(log)
            odd = with_pictures(log, states, odd)
            if shown is None:  # labels need none, or an earlier version tried fewer lags
                shown = measure_lag(log, states)
                lag = lag and LagFinding(shown)
            for pair in (same := same_pictures(log)):
                copies = "`bc-index --cameras center` leaves the copies out"
                findings.append(Finding("cameras with the same pictures", f"{pair}; {copies}"))
            if (swapped := "" if same else swapped_cameras(log)) == "left and right":
                left_out = "`bc-index --cameras center` leaves them out"
                findings.append(Finding("side cameras that are swapped", f"{swapped}; {left_out}"))
            elif swapped:
                findings.append(Finding("cameras that are swapped", f"{swapped}; import the recording again"))
        if shown is not None and shown.is_mirrored:
            findings.append(Finding("sessions whose pictures turn the other way", "all rows; is left right?"))
        if shown is not None and (timing := wrong_timing(shown)):
            findings.append(Finding("sessions whose steering is late or early", f"all rows; {timing}"))
    odd = fine.untagged(odd)
    findings += odd_findings(excluded.untagged(odd))
    pauses = [finding for finding in findings if finding.kind == GAPS and is_paused_by_people]
    return Checked(
        path,
        sum(contents.counts.values()),
        contents.pictures,
        damage + [finding for finding in findings if finding not in pauses],
        bool(damage),
        has_crcs,
        contents.meant_gaps,
        [finding.where for finding in pauses if finding.where not in contents.set_back],
        contents.set_back,
        lag,
        odd,
    )


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
