"""A damaged log: whatever byte is broken and wherever it is cut, what is given out is what was recorded.

The logs are held against mcap's own reader. What no chunk's CRC covers: the log's first record (profile, library),
the times in a chunk's header (nothing here reads them) and the metadata records, whose text may come back changed.
The CRC of all data of a finished log covers them, and `bc-log check`, which reads the whole file, compares it.
No CRC covers the messages of a file without chunks, which only other programs write.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import struct
import tracemalloc
import zlib
from functools import partial
from pathlib import Path

import lz4.frame
import pyarrow as pa
import pytest
import zstandard
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.writer import CompressionType

from common import UserError
from recorder import Log, LogError
from recorder.bc_pb2 import VehicleState
from recorder.topics import VEHICLE
from recorder.upkeep.check import check
from recorder.upkeep.derived_log import LAST_ROW
from recorder.upkeep.recover import recover
from tests.helpers.layouts import Layout, mixed, two_kinds
from tests.helpers.logs import write_log
from tests.helpers.plain_mcap import Contents, Stored, contents, write_plain

MAGIC_BYTES = 8
MASKS = (0xFF, 0x01)
CHUNK_TO_MESSAGE = 0x03  # between their opcodes

Given = tuple[str, int, int, object]  # camera or "vehicle", row, log time, what it was


@pytest.fixture(params=["two kinds", "mixed"])
def layout(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Layout:
    """Logs have chunks of 400 bytes, of either layout."""
    monkeypatch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", 400)
    return two_kinds if request.param == "two kinds" else partial(mixed, chunk_bytes=400)


@pytest.fixture
def whole(tmp_path: Path, layout: Layout) -> Path:
    """Two rows in three chunks, or in four."""
    path = layout(write_log(tmp_path / "whole.mcap", [0.25, -0.5], cameras=("center",)))
    topics = [[message.topic for message in chunk.messages] for chunk in contents(path).chunks]
    image, state = "/camera/center", VEHICLE
    assert topics == (
        [[image], [image], [state], [state]] if layout is two_kinds else [[image], [state], [image, state]]
    )
    return path


def recorded_in(messages: list[Stored]) -> set[Given]:
    """What Log should make of these messages."""
    given: set[Given] = set()
    for message in messages:
        if message.topic == VEHICLE:
            state = VehicleState.FromString(message.data)
            given.add(("vehicle", message.sequence, message.log_time, (state.steering, state.speed_mph)))
        else:
            picture = CompressedImage.FromString(message.data).data
            given.add((message.topic.removeprefix("/camera/"), message.sequence, message.log_time, picture))
    return given


def given_out(path: Path) -> set[Given]:
    """Every state and picture that Log gives out of a file; nothing but a LogError may stop it."""
    given: set[Given] = set()
    with contextlib.suppress(LogError), Log(path) as log:
        ask_for_the_rest(log)
        with contextlib.suppress(LogError):
            for state in log.vehicle().to_pylist():
                given.add(("vehicle", state["row"], state["log_time_ns"], (state["steering"], state["speed_mph"])))
        with contextlib.suppress(LogError):
            for frame in log.frames().to_pylist():
                with contextlib.suppress(LogError):
                    picture = log.read(frame["offset"], frame["length"], frame["chunk"])
                    given.add((frame["camera"], frame["row"], frame["log_time_ns"], picture))
    return given


def ask_for_the_rest(log: Log) -> None:
    parts = (
        lambda: log.metadata,
        lambda: log.counts,
        lambda: log.time_range_ns,
        lambda: log.fingerprint,
        lambda: log.notice,
        lambda: list(log.commands()),
    )
    for part in parts:
        with contextlib.suppress(LogError):
            part()


def recovered(path: Path) -> Contents | None:
    """The log recovered from `path`, as mcap's reader sees it with every CRC checked; None if there is none."""
    to = path.with_name("recovered.mcap")
    to.unlink(missing_ok=True)
    try:
        written = recover(path, to)
    except UserError:
        assert not to.exists()
        return None
    content = contents(to)
    assert written.messages == len(content.messages)
    return content


def wrong_in_recovered(path: Path, truth: list[Stored], least: list[Stored]) -> list[str]:
    """What a recovered log has that was never recorded, or lacks though it was whole in the damaged one."""
    content = recovered(path)
    kept = set() if content is None else set(content.messages)
    return [f"recovered {m}" for m in kept - set(truth)] + [f"did not recover {m}" for m in set(least) - kept]


def overwrite(path: Path, position: int, value: int) -> None:
    with path.open("rb+", buffering=0) as stream:
        stream.seek(position)
        stream.write(bytes([value]))


RECOVER_EVERY = 7  # bytes: recovering takes longer than reading
EVERY = pytest.mark.parametrize("every", [23, pytest.param(1, marks=pytest.mark.long)])  # odd: both MASKS in turn


def complaints_of_flips(path: Path, positions: range) -> list[str]:
    """Flip the bytes of a sound log one by one, and say where that made anything wrong."""
    whole, original = path.read_bytes(), contents(path)
    truth = recorded_in(original.messages)
    damaged = path.with_name("damaged.mcap")
    damaged.write_bytes(whole)
    chunk_starts = {chunk.start for chunk in original.chunks}
    complaints = []
    for position in sorted({*positions, *chunk_starts}):
        hit = [m.sequence for c in original.chunks if c.start <= position < c.end for m in c.messages]
        untouched = [m for m in original.messages if m.sequence not in hit]  # a row is kept whole
        least = [] if position < MAGIC_BYTES else untouched
        masks = MASKS if positions.step == 1 else MASKS[position % 2 :][:1]
        for mask in (*MASKS, CHUNK_TO_MESSAGE) if position in chunk_starts else masks:
            overwrite(damaged, position, whole[position] ^ mask)
            given = [f"gave out {wrong}" for wrong in given_out(damaged) - truth]
            if position % RECOVER_EVERY == 0 or position in chunk_starts:
                given += wrong_in_recovered(damaged, original.messages, least)
            complaints += [f"byte {position} ^ {mask:#x}: {what}" for what in given]
        overwrite(damaged, position, whole[position])
    return complaints


def complaints_of_cuts(path: Path, lengths: range) -> list[str]:
    """Cut a sound log at many lengths, and say where what came back is not exactly what was complete."""
    whole, original = path.read_bytes(), contents(path)
    cut = path.with_name("cut.mcap")
    cut.write_bytes(whole)
    complaints = []
    for length in reversed(lengths):
        os.truncate(cut, length)
        complete = [message for chunk in original.chunks if chunk.end <= length for message in chunk.messages]
        given = given_out(cut)
        what = [] if given == recorded_in(complete) else [f"{len(complete)} are complete, gave out {given}"]
        if length % RECOVER_EVERY == 0 or any(abs(length - chunk.end) < 2 for chunk in original.chunks):
            # a chunk that lacks only the end of its compressed frame unpacks to what its CRC tells
            last_row = max((m.sequence for m in complete if m.topic == VEHICLE), default=LAST_ROW)
            finished = [message for message in complete if message.sequence <= last_row]
            what += wrong_in_recovered(cut, original.messages, finished)
        complaints += [f"cut at {length}: {one}" for one in what]
        if length >= MAGIC_BYTES:
            with Log(cut) as log:
                if not log.problem or str(cut) not in log.notice:
                    complaints.append(f"cut at {length}: no notice")
    return complaints


@EVERY
def test_no_byte_that_is_flipped_makes_a_log_give_out_anything_wrong(whole: Path, every: int) -> None:
    assert complaints_of_flips(whole, range(0, whole.stat().st_size, every)) == []


@EVERY
def test_wherever_a_log_is_cut_all_complete_chunks_are_read(whole: Path, every: int) -> None:
    assert complaints_of_cuts(whole, range(0, whole.stat().st_size, every)) == []


@EVERY
@pytest.mark.parametrize(
    "compression", [CompressionType.ZSTD, pytest.param(CompressionType.LZ4, marks=pytest.mark.long)]
)
def test_the_same_holds_for_compressed_logs(tmp_path: Path, compression: CompressionType, every: int) -> None:
    path = write_plain(tmp_path / "whole.mcap", compression, range(3))
    size = path.stat().st_size
    assert len(contents(path).chunks) == 2
    assert complaints_of_flips(path, range(0, size, every)) == []
    assert complaints_of_cuts(path, range(0, size, max(every, 5))) == []


@pytest.mark.parametrize("every", [13, pytest.param(1, marks=pytest.mark.long)])
def test_a_killed_recording_with_any_broken_byte_loses_one_chunk(whole: Path, every: int) -> None:
    """Without an end that tells where the chunks are, those behind the damage are searched for.

    A topic is described in the chunk of its first message, and nobody knows what follows on it without that.
    """
    original = contents(whole)
    end = original.chunks[-1].end
    first = {message.topic: message for message in reversed(original.messages)}
    chunk_starts = {chunk.start for chunk in original.chunks}
    data = whole.read_bytes()[:end]
    killed = whole.with_name("killed.mcap")
    killed.write_bytes(data)
    complaints = []
    for position in sorted({*range(MAGIC_BYTES, end, every), *chunk_starts}):
        mask = MASKS[position % 2] if position not in chunk_starts else CHUNK_TO_MESSAGE
        overwrite(killed, position, data[position] ^ mask)
        hit = [message for c in original.chunks if c.start <= position < c.end for message in c.messages]
        undescribed = {topic for topic, message in first.items() if message in hit}
        least = [m for m in original.messages if m not in hit and m.topic not in undescribed]
        given = given_out(killed)
        overwrite(killed, position, data[position])
        if not recorded_in(least) <= given <= recorded_in(original.messages):
            complaints.append(f"byte {position}: gave out {given}, whole are {least}")
    assert complaints == []


def test_broken_metadata_costs_a_recovery_nothing_else(whole: Path) -> None:
    path = whole.with_name("damaged.mcap")
    path.write_bytes(whole.read_bytes().replace(b"\x06\x00\x00\x00source", b"\xff\xff\x00\x00source"))
    written = recover(path, whole.with_name("recovered.mcap"))
    assert contents(written.path).by_topic == contents(whole).by_topic
    assert list(written.skipped.counts) == ["damaged metadata records"]


def test_damage_that_only_the_crc_of_all_data_shows_is_reported(whole: Path) -> None:
    """No other CRC covers metadata: nobody knows what it was."""
    path = whole.with_name("damaged.mcap")
    path.write_bytes(whole.read_bytes().replace(b"\x04\x00\x00\x00test", b"\x04\x00\x00\x00tesu"))
    assert [kind for kind, _ in check(path, look=False).findings if "CRC" in kind]


def test_a_file_in_which_nothing_is_whole_is_not_recovered(whole: Path) -> None:
    path = whole.with_name("damaged.mcap")
    path.write_bytes(whole.read_bytes()[: contents(whole).chunks[0].end - 1])
    with pytest.raises(LogError, match=r"damaged\.mcap: no complete message"):
        recover(path, whole.with_name("recovered.mcap"))
    assert not whole.with_name("recovered.mcap").exists()


def test_a_log_without_chunks_has_a_fingerprint_of_its_pictures(tmp_path: Path) -> None:
    """Only other programs write such files; no CRC tells one picture from another there."""

    def fingerprint(picture: bytes) -> str:
        path = tmp_path / f"{picture[:3].decode()}.mcap"
        write_plain(path, CompressionType.NONE, range(3), use_chunking=False, picture=picture)
        with Log(path) as log:
            assert log.counts == {"/camera/center": 3, "/vehicle": 3}
            return log.fingerprint

    assert fingerprint(b"one" + bytes(500) + b"1") != fingerprint(b"two" + bytes(500) + b"1")
    assert fingerprint(b"one" + bytes(500) + b"1") != fingerprint(b"one" + bytes(500) + b"2")


def of_lengths(path: Path, lengths: list[int]) -> Path:
    """A log with a picture of each length."""
    steering = [row / 100 for row in range(len(lengths))]
    return write_log(path, steering, lambda _, row: bytes([row]) * lengths[row], cameras=("center",))


@pytest.mark.parametrize("is_killed", [False, True], ids=["finished", "killed"])
def test_chunks_that_have_changed_places_are_all_kept(tmp_path: Path, layout: Layout, is_killed: bool) -> None:
    """Where their lengths differ, what is between them has moved, too."""
    whole = layout(of_lengths(tmp_path / "whole.mcap", [50, 90, 40, 20, 70, 70, 30, 60]))
    original, data = contents(whole), whole.read_bytes()
    chunks = original.chunks
    damaged, to = whole.with_name("damaged.mcap"), whole.with_name("recovered.mcap")
    for i, j in itertools.combinations(range(len(chunks)), 2):
        first, second = chunks[i], chunks[j]
        parts = [
            (0, first.start),
            (second.start, second.end),
            (first.end, second.start),
            (first.start, first.end),
            (second.end, None),
        ]
        swapped = b"".join(data[start:end] for start, end in parts)
        damaged.write_bytes(swapped[: chunks[-1].end] if is_killed else swapped)
        recover(damaged, to, overwrite=True)
        assert set(contents(to).messages) == set(original.messages), (i, j)


# Lies: lengths that nobody should believe


def chunk(records: bytes, *, size: int, compression: bytes, stored: bytes, length: int | None = None) -> bytes:
    """A chunk that tells `size` as its unpacked size, and perhaps another `length` than it has."""
    header = struct.pack("<QQQI", 0, 0, size, zlib.crc32(records))
    content = header + struct.pack("<I", len(compression)) + compression + struct.pack("<Q", len(stored)) + stored
    return struct.pack("<BQ", 6, len(content) if length is None else length) + content


def unfinished(path: Path, *parts: bytes) -> Path:
    path.write_bytes(b"\x89MCAP0\r\n" + b"".join(parts))
    return path


def peak_bytes_of_reading(path: Path) -> int:
    pa.table({"row": [1]}).sort_by("row")  # loads the rest of pyarrow
    tracemalloc.start()
    try:
        given_out(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


GIGABYTE = 1 << 30


@pytest.mark.parametrize("size", [8 * GIGABYTE, 1 << 20, 0])
@pytest.mark.parametrize("compression", [b"zstd", b"lz4"])
def test_a_chunk_that_would_unpack_to_gigabytes_is_not_unpacked(
    tmp_path: Path, size: int, compression: bytes
) -> None:
    """Whatever size it tells: the true one, a small one, none."""
    zeros = bytes(1 << 24)
    pack = zstandard.compress if compression == b"zstd" else lz4.frame.compress
    bomb = pack(zeros)
    if compression == b"zstd":  # frames in a row unpack to the sum of them
        bomb *= 512
    path = unfinished(tmp_path / "a.mcap", chunk(zeros, size=size, compression=compression, stored=bomb))
    del zeros
    assert peak_bytes_of_reading(path) < 1 << 24


@pytest.mark.parametrize("opcode", [3, 4, 5, 6, 7, 9, 12, 0x80])
def test_a_record_that_lies_about_its_length_takes_no_memory(
    whole: Path, monkeypatch: pytest.MonkeyPatch, opcode: int
) -> None:
    """The file is as long as the record says, but sparse."""
    for module in ("mcap_file", "scan"):
        monkeypatch.setattr(f"recorder.mcap.{module}.MAX_RECORD_BYTES", 1 << 20)
    complete = contents(whole).chunks[-1]
    path = whole.with_name("damaged.mcap")
    path.write_bytes(whole.read_bytes()[: complete.end] + struct.pack("<BQ", opcode, 1 << 24))
    os.truncate(path, path.stat().st_size + (1 << 24))
    assert peak_bytes_of_reading(path) < 1 << 22
    assert given_out(path) == recorded_in(contents(whole).messages)
    with Log(path) as log:
        assert log.lost == [(complete.end, path.stat().st_size)]


def test_a_summary_with_a_bomb_in_it_is_not_unpacked(whole: Path) -> None:
    zeros = bytes(1 << 26)
    bomb = chunk(zeros, size=len(zeros), compression=b"zstd", stored=zstandard.compress(zeros))
    del zeros
    data = whole.read_bytes()
    start = struct.unpack_from("<Q", data, len(data) - MAGIC_BYTES - 20)[0]
    footer = struct.pack("<BQQQI", 2, 20, start, 0, 0) + b"\x89MCAP0\r\n"  # a CRC of 0: none
    path = whole.with_name("damaged.mcap")
    path.write_bytes(data[: -MAGIC_BYTES - 29] + bomb + footer)
    assert peak_bytes_of_reading(path) < 1 << 24


def test_a_disk_that_gives_nothing_is_a_log_error(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A failing disk: no other test can make one."""

    def fail(*_: object) -> bytes:
        raise OSError(5, "Input/output error")

    with Log(whole) as log:
        monkeypatch.setattr("os.pread", fail)
        with pytest.raises(LogError, match=r"whole\.mcap: damaged: .*Input/output error"):
            log.vehicle()
