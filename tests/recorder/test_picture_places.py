"""The end of a log tells where its pictures lie, and which CRCs its chunks have. What cannot be is not believed:
then all of the log is read, as one that tells nothing. `bc-log check` finds what is not so.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import ChunkIndex, McapRecord
from mcap.writer import CompressionType

from common.car import CAMERAS
from recorder import Log
from recorder.upkeep.check import check
from recorder.upkeep.edit import merge, split, trim
from recorder.upkeep.recover import recover
from tests.helpers.logs import flip_bit, write_log
from tests.helpers.mcap_patch import patched
from tests.helpers.plain_mcap import CopiedTopics, contents, plain_writer
from tests.helpers.udacity import picture

PLACE = struct.Struct("<HIQIIIII")  # channel, row, time, chunk, offset, length, picture, its length
CHUNK = struct.Struct("<QI")  # start, CRC
ROWS = 40
NOT_OURS = "lists that describe another file"
OTHER_PICTURES = "chunks with wrong pictures in the list"

Places = list[list[int]]
Change = Callable[[Places], Places]


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Forty rows, in many chunks of both kinds."""
    monkeypatch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", 9000)
    return write_log(tmp_path / "a.mcap", [row / 100 for row in range(ROWS)], picture)


def given_out(path: Path) -> tuple[list[object], dict[tuple[str, int], bytes]]:
    with Log(path) as log:
        frames = log.frames().to_pylist()
        pictures = {(f["camera"], f["row"]): log.read(f["offset"], f["length"], f["chunk"]) for f in frames}
        return log.vehicle().to_pylist(), pictures


def kinds_of(path: Path) -> set[str]:
    return {kind for kind, _ in check(path, look=False).findings}


def changed(name: str, layout: struct.Struct, change: Change) -> Callable[[str, bytes], bytes]:
    def attachment(its_name: str, content: bytes) -> bytes:
        if its_name != name:
            return content
        entries = [list(entry) for entry in layout.iter_unpack(content)]
        return b"".join(layout.pack(*entry) for entry in change(entries))

    return attachment


def with_field(field: int, value: Callable[[int], int], at: int = 50) -> Change:
    def change(entries: Places) -> Places:
        entries[at][field] = value(entries[at][field])
        return entries

    return change


def exchanged(one: int, two: int, *fields: int) -> Change:
    def change(entries: Places) -> Places:
        for field in fields or range(len(entries[0])):
            entries[one][field], entries[two][field] = entries[two][field], entries[one][field]
        return entries

    return change


def test_it_shows_the_truth(path: Path) -> None:
    rows, pictures = given_out(path)
    assert pictures == {(camera, row): picture(camera, row) for camera in CAMERAS for row in range(ROWS)}
    assert len(rows) == ROWS
    assert check(path, look=False).findings == []


IMPOSSIBLE: dict[str, Change] = {
    "a time that no table can hold": with_field(2, lambda _: 2**64 - 1),
    "a chunk that is not there": with_field(3, lambda _: 2**32 - 1),
    "none": lambda _: [],
    "one too few": lambda entries: entries[:-1],
    "one too many": lambda entries: [*entries, entries[-1]],
}


@pytest.mark.parametrize("change", IMPOSSIBLE.values(), ids=IMPOSSIBLE)
def test_what_cannot_be_is_not_believed(path: Path, change: Change) -> None:
    truth = given_out(path)
    patched(path, changed("bc.pictures", PLACE, change))
    contents(path)  # every CRC holds
    assert given_out(path) == truth
    assert kinds_of(path) & {OTHER_PICTURES, NOT_OURS}


FALSE: dict[str, Change] = {
    "channels": exchanged(50, 51, 0),
    "row": with_field(1, lambda row: row + 1),
    "time": with_field(2, lambda time_ns: time_ns + 1),
    "place": with_field(4, lambda offset: offset + 1),
    "length": with_field(5, lambda length: length - 1),
    "place of the picture": with_field(6, lambda offset: offset + 1),
    "length of the picture": with_field(7, lambda length: length - 1),
    "no picture": with_field(6, lambda _: 2**32 - 1),
}


@pytest.mark.parametrize("change", FALSE.values(), ids=FALSE)
def test_whatever_is_false_of_a_picture_is_found(path: Path, change: Change) -> None:
    patched(path, changed("bc.pictures", PLACE, change))
    findings = check(path, look=False).findings
    assert {kind for kind, _ in findings} <= {OTHER_PICTURES, NOT_OURS}
    starts = [f"at byte {chunk.start:,}" for chunk in contents(path).chunks]
    assert findings
    assert all(where in [*starts, "bc.pictures"] for _, where in findings)


def test_another_crc_of_a_chunk_is_found(path: Path) -> None:
    patched(path, changed("bc.chunks", CHUNK, with_field(1, lambda crc: crc ^ 1, at=3)))
    start = contents(path).chunks[3].start
    assert check(path, look=False).findings == [("chunks with wrong CRCs in the list", f"at byte {start:,}")]


@pytest.mark.parametrize("change", [with_field(0, lambda start: start + 1, at=3), exchanged(2, 3), lambda _: []])
def test_a_list_of_other_chunks_is_of_another_file(path: Path, change: Change) -> None:
    truth = given_out(path)
    patched(path, changed("bc.chunks", CHUNK, change))
    assert given_out(path) == truth
    assert check(path, look=False).findings == [(NOT_OURS, "bc.chunks")]


@pytest.mark.parametrize("names", [{"bc.pictures"}, {"bc.chunks"}, {"bc.pictures", "bc.chunks"}])
def test_without_it_all_is_read(path: Path, names: set[str]) -> None:
    """A log may have none of it: those of earlier versions do not."""
    truth = given_out(path)
    with Log(path) as log:
        fingerprint = log.fingerprint
    size = path.stat().st_size
    patched(path, lambda name, content: None if name in names else content)
    assert given_out(path) == truth
    assert kinds_of(path) == (set() if len(names) == 2 else {NOT_OURS})
    assert path.stat().st_size < size
    with Log(path) as log:
        assert log.fingerprint != fingerprint  # another file


@pytest.mark.parametrize("name", [b"bc.pictures", b"bc.chunks"])
def test_a_damaged_one_is_not_believed(path: Path, name: bytes) -> None:
    truth, messages = given_out(path), contents(path).by_topic
    at = path.read_bytes().index(name)
    flip_bit(path, at + 100)
    assert given_out(path) == truth
    assert ("damaged attachments", f"{name.decode()} at byte {at - 29:,}") in check(path, look=False).findings
    written = recover(path, path.with_name("b.mcap"))
    assert contents(written.path).by_topic == messages
    assert len(written.skipped) == 0
    assert check(written.path, look=False).findings == []


# The summary


def of_chunks(change: Callable[[ChunkIndex], None], number: int) -> Callable[[McapRecord], None]:
    seen: list[ChunkIndex] = []

    def summary(record: McapRecord) -> None:
        if isinstance(record, ChunkIndex):
            seen.append(record)
            if len(seen) == number + 1:
                change(record)

    return summary


def without_a_topic(index: ChunkIndex) -> None:
    index.message_index_offsets.popitem()


def with_a_topic(index: ChunkIndex) -> None:
    index.message_index_offsets[4] = min(index.message_index_offsets.values())


def at_other_times(index: ChunkIndex) -> None:
    index.message_end_time += 1


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (without_a_topic, "chunks with wrong topics in the summary"),
        (with_a_topic, "chunks with wrong topics in the summary"),
        (at_other_times, "chunks with wrong times or sizes in the summary"),
    ],
)
def test_what_the_summary_shows_falsely_of_a_chunk_is_found(
    path: Path, change: Callable[[ChunkIndex], None], kind: str
) -> None:
    """By what it tells, chunks of pictures are passed over."""
    truth = given_out(path)
    patched(path, summary=of_chunks(change, 2))
    start = contents(path).chunks[2].start
    assert (kind, f"at byte {start:,}") in check(path, look=False).findings
    assert given_out(path) == truth


# Copies


def copied(path: Path, to: Path, first_row: int = 0, chunk_bytes: int = 3000, profile: str = "bc") -> Path:
    """As another program copies a log, or a version before: other chunks, and attachments as they are."""
    options = {"chunk_size": chunk_bytes, "compression": CompressionType.NONE, "enable_data_crcs": True}
    with path.open("rb") as source:
        reader = make_reader(source)
        with plain_writer(to, profile, reader.get_header().library, **options) as writer:
            for record in reader.iter_metadata():
                writer.add_metadata(record.name, record.metadata)
            topics = CopiedTopics(writer)
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                topics.channel(schema, channel)
                if message.sequence >= first_row:
                    topics.add(schema, channel, message)
            for attachment in reader.iter_attachments():
                writer.add_attachment(**vars(attachment))
    return to


@pytest.mark.parametrize(("first_row", "chunk_bytes"), [(0, 3000), (7, 300)])
def test_a_copy_in_other_chunks_is_read_as_it_is(path: Path, first_row: int, chunk_bytes: int) -> None:
    rows, pictures = given_out(path)
    copy = copied(path, path.with_name("copy.mcap"), first_row, chunk_bytes)
    assert [name for name, _ in contents(copy).attachments] == ["bc.pictures", "bc.chunks"]
    found_rows, found_pictures = given_out(copy)
    assert found_rows == rows[first_row:]
    assert found_pictures == {key: data for key, data in pictures.items() if key[1] >= first_row}
    assert kinds_of(copy) == {NOT_OURS}
    with Log(copy) as log, Log(path) as original:
        assert log.fingerprint != original.fingerprint
        assert log.attachments == []


def test_a_killed_log_may_show_the_places_of_its_beginning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A long one: they are written every so many pictures. Nothing new has them of it."""
    monkeypatch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", 2000)
    monkeypatch.setattr("recorder.mcap.split_chunks.PLACES_AT_ONCE", 30)
    whole = write_log(tmp_path / "whole.mcap", [row / 100 for row in range(ROWS)], picture)
    original = contents(whole)
    assert [name for name, _ in original.attachments].count("bc.pictures") > 2
    part = tmp_path / "a.mcap.0a1b2c.part"
    part.write_bytes(whole.read_bytes()[: original.chunks[-1].end])
    assert b"bc.pictures" in part.read_bytes()
    assert given_out(part) == given_out(whole)
    made = [
        trim(part, tmp_path / "trimmed.mcap", (5, 30)).path,
        merge([part, part], tmp_path / "merged.mcap").path,
        recover(part, tmp_path / "recovered.mcap").path,
    ]
    made += [written.path for written in split(made[1], tmp_path / "drives")]
    for log in made:
        names = [name for name, _ in contents(log).attachments]
        pictures = sum(len(content) for name, content in contents(log).attachments if name == "bc.pictures")
        assert pictures == PLACE.size * sum(m.topic.startswith("/camera/") for m in contents(log).messages)
        assert names.count("bc.chunks") == 1
        assert kinds_of(log) <= {"gaps in time"}
    assert contents(made[2]).by_topic == original.by_topic
