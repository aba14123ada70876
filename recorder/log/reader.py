"""Reads a log: its metadata, its messages, and the place of each picture in the file.

Chunks with a wrong CRC are never used. Chunks of pictures are read only when needed. An unfinished log is read as
far as it goes, and has a notice (`Log.notice`).
"""

from __future__ import annotations

import contextlib
import hashlib
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np
from mcap.records import Attachment, Channel, Schema
from mcap.records import Message as McapMessage
from numpy.typing import NDArray

from common import Skipped
from common.car import CAMERAS, Camera
from common.closeable import Closeable
from common.location import Location, location
from recorder import topics
from recorder.errors import LogError, recovery
from recorder.mcap.chunk_reader import ChunkReader
from recorder.mcap.mcap_file import CHUNK_HEADER, Chunk, McapFile, has_crc_in, stored_message
from recorder.mcap.message_index import LAST_TIME_NS, UNCOMPRESSED, Read, decode_numbers, known_values
from recorder.mcap.picture_places import LogIndex, Pictures, is_about_places, read_chunk_crcs
from recorder.mcap.scan import DAMAGED, GOES_ON, read_structure, salvage
from recorder.topics import DEVICES

if TYPE_CHECKING:  # training reads pictures where protobuf is not installed; a log's end needs no Arrow
    import pyarrow as pa
    from google.protobuf.message import Message as ProtobufMessage

    from recorder.bc_pb2 import PilotCommand, Prediction, VehicleState

_PLACE: Final = ("offset", "length", "chunk")
_ROWS_AT_ONCE: Final = 4096
_PART: Final = 1 << 23
_NEAR_BYTES: Final = 4096  # reading and checking them takes as long as reading one message alone

Contents = tuple[bytes, NDArray[np.int64], NDArray[np.int64]]
"""Bytes, and the positions in them where each message starts and ends."""
Decoded = TypeVar("Decoded", bound="ProtobufMessage")


@dataclass(frozen=True)
class Message:
    """One message: its content is `length` bytes from `offset`."""

    sequence: int
    log_time_ns: int
    offset: int  # in the file, or in its unpacked chunk
    length: int
    chunk: int = UNCOMPRESSED  # start of its compressed chunk in the file


class Log(Closeable):
    """A log, open for reading. Use it as a context manager, or call `close()`.

    `salvages`: for a recovery, also find whole chunks in wrong places. `shows_progress`: show a progress bar while
    the log is read, at the first use of messages. Raises LogError if the file is missing, damaged or not an MCAP
    file.
    """

    def __init__(self, path: Location | str, *, salvages: bool = False, shows_progress: bool = False) -> None:
        self.path = location(path)
        self._shows_progress = shows_progress
        self._file = McapFile(self.path)
        try:
            self._structure = self._as_found = read_structure(self._file)
            if not salvages:
                self._file.check_count(self.message_count)
            else:
                self._as_found = replace(self._structure, chunks=list(self._structure.chunks))
                salvage(self._file, self._structure)
            self.size = self._file.size
            """Bytes of the file at its opening."""
        except BaseException:
            self._file.close()
            raise
        self.problem = self._structure.problem
        """The reason why the log is unfinished; empty for a finished log."""
        self.lost = self._structure.lost
        """Stretches of bytes (from, to) without anything whole. In a finished log, only `salvages` finds them."""
        self.channels = self._structure.channels
        self.chunks = self._structure.chunks
        """The chunks, in the order of the file."""
        self._pictures: dict[str, Pictures] = {}

    def close(self) -> None:
        self._file.close()

    @cached_property
    def _chunk_reader(self) -> ChunkReader:
        return ChunkReader(self._file, self.chunks)

    @property
    def is_remote(self) -> bool:
        return self._file.is_remote

    def all_bytes(self) -> Iterator[bytes]:
        """The whole file, in parts. Raises LogError, StoreError."""
        return self._file.read_many((at, min(_PART, self.size - at)) for at in range(0, self.size, _PART))

    def read_from(self, copy: Path) -> None:
        """Read a copy of the file from now on; `path` stays unchanged. Raises OSError."""
        self._file.read_from(copy)

    @property
    def notice(self) -> str:
        """A line to print before an unfinished log is used; empty for a finished log."""
        if not self.problem:
            return ""
        middle = sum(end - start for start, end in self.lost if end < self.size)
        also = f", and {middle:,} bytes before it are damaged" if middle and self.problem != DAMAGED else ""
        finisher = "The end of the recording" if self.problem == GOES_ON else recovery(self.path)
        state = f"{self.problem}{also}; its complete parts are read"
        return f"{self.path}: {state}. {finisher} makes a finished log of it"

    @property
    def has_crcs(self) -> bool:
        """True if all chunks have CRCs. Other programs may write none: then damage is not noticed."""
        return self._file.have_crcs(self.chunks)

    @property
    def is_ours(self) -> bool:
        """True for a log of this toolkit, with the topics and row numbers of docs/log-format.md."""
        return self._file.is_ours

    @property
    def is_indexed(self) -> bool:
        """True if the log's end lists its channels and chunks, and for each chunk where its messages are. All of
        this is optional in MCAP."""
        return self._structure.statistics is not None and all(chunk.channels for chunk in self.chunks)

    @property
    def schemas(self) -> dict[str, str]:
        """The schema's name of each topic; empty without a schema."""
        names = {number: schema.name for number, schema in self._structure.schemas.items()}
        return {channel.topic: names.get(channel.schema_id, "") for channel in self.channels.values()}

    @property
    def metadata(self) -> dict[str, str]:
        """The record `bc.session`: the source of the log; empty without one."""
        return self.read_metadata(topics.SESSION_METADATA)

    def read_metadata(self, name: str) -> dict[str, str]:
        """The last metadata record named `name`, or {}."""
        return dict(self.all_metadata).get(name, {})

    @cached_property
    def all_metadata(self) -> Sequence[tuple[str, dict[str, str]]]:
        """Names and values of all metadata records, in the file's order."""
        return [self.metadata_record(offset) for offset in self.metadata_records]

    @property
    def metadata_records(self) -> list[int]:
        return sorted(self._structure.metadata_at)

    def metadata_record(self, offset: int) -> tuple[str, dict[str, str]]:
        """Name and values of a metadata record. Only a finished log's CRC of all data covers it. `bc-log check`
        compares this CRC, which takes reading the whole file."""
        record = self._file.metadata(offset)
        return record.name, dict(record.metadata)

    @property
    def attachments(self) -> list[int]:
        """Offsets of the attachments (MCAP's files in a log), without those with the places of pictures."""
        names = self._structure.attachment_names
        return [at for at in sorted(self._structure.attachments_at) if not is_about_places(names.get(at, ""))]

    def attachment(self, offset: int) -> Attachment:
        return self._file.attachment(offset)

    @property
    def message_count(self) -> int:
        """The number of messages by the log's own statistics; 0 without statistics."""
        return 0 if self._structure.statistics is None else self._structure.statistics.message_count

    @property
    def counts(self) -> dict[str, int]:
        """The number of messages of each topic, from the summary if there is one."""
        if self._structure.statistics is not None:
            by_channel = self._structure.statistics.channel_message_counts
        else:
            uniques = np.unique(self._index.all["channel"], return_counts=True)
            by_channel = dict(zip(*(column.tolist() for column in uniques), strict=True))
        counts: dict[str, int] = {}
        for number, channel in self.channels.items():
            counts[channel.topic] = counts.get(channel.topic, 0) + by_channel.get(number, 0)
        return counts

    @property
    def time_range_ns(self) -> tuple[int, int]:
        """The lowest and the highest log time; (0, 0) without messages."""
        if (statistics := self._structure.statistics) is not None:
            first_ns, last_ns = statistics.message_start_time, statistics.message_end_time
            if first_ns <= last_ns <= LAST_TIME_NS:  # another program may write anything
                return first_ns, last_ns
        times = self._index.all["log_time_ns"]
        return (int(times.min()), int(times.max())) if len(times) else (0, 0)

    @cached_property
    def fingerprint(self) -> str:
        """A name for this content: `file_fingerprint`, or the fingerprint of the original if `bc-log rewrite` made
        this log, with the same messages at other places."""
        rewritten: dict[str, str] = {}
        for offset in self.metadata_records if self.is_ours else ():
            with contextlib.suppress(LogError):  # a damaged record raises when it is used
                name, values = self.metadata_record(offset)
                rewritten = values if name == topics.REWRITTEN_METADATA else rewritten
        original = rewritten.get("fingerprint", "")
        # another program, or an earlier version, may have copied the record to a log with other chunks
        is_about_this = original and rewritten.get("chunks") == _sha256(*self._chunk_headers)
        return original if is_about_this else self.file_fingerprint

    @cached_property
    def file_fingerprint(self) -> str:
        """A name for this file: SHA-256 over its size and the chunks' headers, which contain CRCs. It changes with
        any picture and with its place."""
        return _sha256(struct.pack("<Q", self.size), *self._chunk_headers)

    @cached_property
    def _chunk_headers(self) -> list[bytes]:
        """The header of each chunk, from the end of a log of ours; for other logs, some 50 bytes a chunk are
        read."""
        # of a salvaged log, the chunks before the salvage: its tags have their fingerprint
        chunks = self.chunks if self._as_found is self._structure else self._as_found.chunks
        crcs = read_chunk_crcs(self._file, self._as_found) if self.is_ours else None
        if crcs is not None:
            return [chunk.head + struct.pack("<I", crc) for chunk, crc in zip(chunks, crcs, strict=True)]
        heads = self._file.read_many(
            (chunk.start, min(CHUNK_HEADER.size, chunk.end - chunk.start)) for chunk in chunks
        )
        return [
            head if has_crc_in(chunk, head) else self._file.read(chunk.start, chunk.end - chunk.start)
            for chunk, head in zip(chunks, heads, strict=True)
        ]

    def read(self, offset: int, length: int, chunk: int = UNCOMPRESSED) -> bytes:
        """`length` bytes from `offset`, as in `Pictures` and `Message`. Thread-safe.

        Raises LogError if the CRC of their chunk does not match; it is computed once for each chunk.
        """
        return self._chunk_reader.read(offset, length, chunk)

    def frames(self) -> pa.Table:
        """The cameras' pictures, one a row, in the file's order: row (the frame's number in the log), camera,
        log_time_ns, offset, length and chunk (for `read`)."""
        import pyarrow as pa

        parts = []
        for camera in CAMERAS:
            pictures = self.pictures(topics.camera_topic(camera))
            columns = {
                "row": pictures.sequence,
                "camera": pa.array([camera] * len(pictures.sequence), pa.string()),
                **{name: getattr(pictures, name) for name in ("log_time_ns", "offset", "length", "chunk")},
            }
            parts.append(pa.table(columns))
        return pa.concat_tables(parts).sort_by([("chunk", "ascending"), ("offset", "ascending")])

    def vehicle(self) -> pa.Table:
        """The vehicle states, one a row: row, log_time_ns, steering (-1 left .. 1 right), throttle and brake
        (0 .. 1), speed_mph (NaN if the source has none)."""
        return self.numbers(topics.VEHICLE, topics.VEHICLE_COLUMNS)

    def devices(self) -> NDArray[np.int8]:
        """A person's device in each vehicle state (N,), as its position in `DEVICES`."""
        return known_values(self.numbers(topics.VEHICLE, ["device"])["device"].to_numpy(), len(DEVICES))

    def numbers(self, topic_name: str, fields: Sequence[str]) -> pa.Table:
        """Fields of the messages on a topic of the registry, one message a row: row, log_time_ns, and each field
        by its name; NaN for a missing optional field."""
        import pyarrow as pa
        from google.protobuf.message import DecodeError

        entries = self._index.of_topic(topic_name)
        kind = topics.TOPICS[topic_name].message.load()
        try:
            parts = [decode_numbers(*part, kind, fields) for part in self._contents(entries)]
        except DecodeError as error:
            raise self._no_such_message(topic_name, kind) from error
        columns = {
            "row": entries["sequence"].astype(np.int64),
            "log_time_ns": entries["log_time_ns"].astype(np.int64),
        }
        values = np.concatenate([np.empty((len(fields), 0)), *parts], axis=1)
        return pa.table(columns | dict(zip(fields, values, strict=True)))

    def picture(self, row: int, camera: Camera = "center") -> bytes:
        """The JPEG or PNG of a camera at a row, byte for byte. Raises LogError if there is none."""
        pictures = self.pictures(topics.camera_topic(camera))
        (at,) = np.nonzero(pictures.sequence == row)
        if not len(at):
            raise LogError(f"{self.path}: row {row} has no picture of the {camera} camera")
        return self.read(int(pictures.offset[at[0]]), int(pictures.length[at[0]]), int(pictures.chunk[at[0]]))

    def pictures(self, topic: str) -> Pictures:
        """The places of the pictures of a CompressedImage topic."""
        if topic not in self._pictures:
            table = self._index.of_topic(topic)
            if (table["picture"] < 0).any():
                raise self._file.damaged(f"a message on {topic} is not a CompressedImage")
            names = ("sequence", "log_time_ns", "picture", "picture_length", "chunk")
            self._pictures[topic] = Pictures(*(table[name].astype(np.int64) for name in names))
        return self._pictures[topic]

    def rows_and_times(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Number and log time of every vehicle state, in the log's order."""
        entries = self._index.of_topic(topics.VEHICLE)
        return entries["sequence"].astype(np.int64), entries["log_time_ns"].astype(np.int64)

    def messages(self, topic: str) -> list[Message]:
        """The places of the messages on `topic`, in the order of writing."""
        return _messages(self._index.of_topic(topic))

    def contents(self, topic: str) -> Iterator[tuple[Message, bytes]]:
        """The messages on `topic` with their bytes, in the order of writing."""
        entries = self._index.of_topic(topic)
        contents = (
            data[start:end]
            for data, starts, ends in self._contents(entries)
            for start, end in zip(starts.tolist(), ends.tolist(), strict=True)
        )
        return zip(_messages(entries), contents, strict=True)

    def decoded(self, topic: str) -> Iterator[tuple[Message, Any]]:
        """The messages on a topic of the registry. Raises LogError for a message of another type."""
        return self._decoded(topic, topics.TOPICS[topic].message.load())

    def vehicle_states(self) -> Iterator[tuple[Message, VehicleState]]:
        return self.decoded(topics.VEHICLE)

    def commands(self) -> Iterator[tuple[Message, PilotCommand]]:
        return self.decoded(topics.PILOT_COMMAND)

    def predictions(self, run: str) -> Iterator[tuple[Message, Prediction]]:
        from recorder.bc_pb2 import Prediction

        return self._decoded(topics.prediction_topic(run), Prediction)

    def messages_of(
        self, chunk: Chunk, skipped: Skipped | None = None
    ) -> Iterator[tuple[Schema | None, Channel, McapMessage]]:
        """The messages of one chunk with their schemas and channels, for copying them into another log.

        Invalid messages are added to `skipped`; without it, they raise LogError.
        """
        records = self._file.records(chunk)
        for start in self._file.parts(records).messages:
            stored = stored_message(records, start)
            channel = self.channels.get(stored.channel)
            if channel is None or max(stored.log_time_ns, stored.publish_time_ns) > LAST_TIME_NS:
                fault = "a topic that is not known" if channel is None else "a time that cannot be"
                if skipped is None:
                    raise self._file.damaged(f"a message of {fault}")
                skipped.add(f"messages of {fault}", f"channel {stored.channel}, number {stored.sequence}")
                continue
            data = records[stored.offset : stored.offset + stored.length]
            message = McapMessage(
                stored.channel, stored.log_time_ns, data, stored.publish_time_ns, stored.sequence
            )
            yield self._structure.schemas.get(channel.schema_id), channel, message

    @cached_property
    def _index(self) -> LogIndex:
        return LogIndex(self._file, self._structure, self._tracked, self._chunk_reader.set_verified)

    @property
    def is_mixed(self) -> bool:
        """True if rows cannot be read without pictures, because the pictures' places are not listed."""
        return self._index.is_mixed

    def _tracked(self, read: Iterable[Read], chunks: int) -> Iterable[Read]:
        if not self._shows_progress:
            return read
        from common.progress import track  # training reads logs where no bars are installed

        return track(read, f"reading {self.path.name}", chunks)

    def _decoded(self, topic: str, kind: type[Decoded]) -> Iterator[tuple[Message, Decoded]]:
        from google.protobuf.message import DecodeError

        for message, content in self.contents(topic):
            try:
                yield message, kind.FromString(content)
            except DecodeError as error:
                raise self._no_such_message(topic, kind) from error

    def _contents(self, entries: NDArray[np.void]) -> Iterator[Contents]:
        """The contents of messages of the index, in parts of some megabytes. For messages close together, the
        chunk is read once; messages far apart, among pictures, are read one by one."""
        for at in range(0, len(entries), _ROWS_AT_ONCE):
            rows = entries[at : at + _ROWS_AT_ONCE]
            offset, chunk = rows["offset"], rows["chunk"]
            is_near = (np.diff(offset) < _NEAR_BYTES) | (chunk[1:] != UNCOMPRESSED)
            is_near &= np.diff(self._chunk_reader.chunks_of(offset, chunk)) == 0
            ends = [*(np.flatnonzero(~is_near) + 1).tolist(), len(rows)]
            starts = np.empty(len(rows), np.int64)
            pieces, size, done, first = [], 0, 0, 0
            for end in ends:
                start, length, of_chunk = (int(rows[name][first]) for name in _PLACE)
                if end - first == 1:
                    piece = self._chunk_reader.read(start, length, of_chunk)
                else:
                    start, piece = self._chunk_reader.records_around(start, length, of_chunk)
                starts[first:end] = offset[first:end] + (size - start)
                pieces.append(piece)
                size += len(piece)
                first = end
                if size >= _PART or end == len(rows):
                    begins, stops = starts[done:end], starts[done:end] + rows["length"][done:end]
                    if begins.min() < 0 or stops.max() > size:
                        raise self._file.damaged("a message lies outside its chunk")
                    yield b"".join(pieces), begins, stops
                    pieces, size, done = [], 0, end

    def _no_such_message(self, topic: str, kind: type[ProtobufMessage]) -> LogError:
        return self._file.damaged(f"a message on {topic} is not a {kind.DESCRIPTOR.full_name}")


def _messages(entries: NDArray[np.void]) -> list[Message]:
    messages = list[Message]()
    for start in range(0, len(entries), _ROWS_AT_ONCE):  # in parts: a Python int takes 32 bytes
        rows = entries[start : start + _ROWS_AT_ONCE]
        messages += map(Message, *(rows[name].tolist() for name in ("sequence", "log_time_ns", *_PLACE)))
    return messages


def _sha256(*parts: bytes) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()
