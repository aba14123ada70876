"""Recordings and logs that somebody made to harm: no command waits for ever, or takes more memory than it may."""

from __future__ import annotations

import os
import resource
import sqlite3
import struct
import subprocess
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zstandard
from mcap.records import Channel, McapRecord, Schema, Statistics
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_protobuf.schema import register_schema
from rosbags.rosbag2 import StoragePlugin

from common.untrusted import open_regular, read_bounded
from recorder import Log, LogError, RecordingError, import_udacity
from recorder.bc_pb2 import VehicleState
from recorder.pictures.picture_size import decodes
from recorder.sources.import_recording import import_recording
from recorder.sources.imported_rows import Imported
from recorder.sources.mcap_messages import decoder_for
from recorder.sources.ros2_bag import yaml_content
from recorder.sources.udacity_follow import watch_udacity
from recorder.sources.udacity_recording import read_udacity
from recorder.upkeep.edit import trim
from recorder.upkeep.recover import recover
from tests.helpers.driving import command, environment, run
from tests.helpers.logs import START_NS, read_messages, write_log
from tests.helpers.mcap_patch import patched
from tests.helpers.other_logs import ROS_TOPICS, write_bag
from tests.helpers.tubs import record_1, record_2, write_tub_1, write_tub_2
from tests.helpers.udacity import jpeg, make_recording, paths, picture_name
from tests.helpers.waiting import PATIENCE_S

MEMORY_BYTES = 1 << 30
HOLE_BYTES = 1 << 42  # of a file without content: it takes no place on the disk
CSV = f"{paths(0)},0,0,0,1\n{paths(1)},0,0,0,1\n"


def recorded(folder: Path) -> Iterator[Imported]:
    """The recording in `folder`/drive, imported, and followed as it is written."""
    yield import_udacity(folder / "drive", folder / "imported.mcap")
    yield watch_udacity(folder / "drive", folder / "followed.mcap", idle_s=0)


def with_hole(path: Path) -> Path:
    try:
        os.truncate(path, HOLE_BYTES)
    except OSError:
        pytest.skip("a file of 4 TB was not tried: the file system has none")
    return path


# Pipes


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    """A pipe that nobody writes to: whoever opens it as a file waits for ever."""
    if not hasattr(os, "mkfifo"):
        pytest.skip("pipes were not tried: this system has none among its files")
    os.mkfifo(tmp_path / "pipe.mcap")
    return tmp_path / "pipe.mcap"


def test_a_pipe_is_no_log(pipe: Path) -> None:
    with pytest.raises(LogError, match="not a regular file"):
        Log(pipe)


@pytest.mark.parametrize("read", [open_regular, lambda path: read_bounded(path, 10)])
def test_only_files_are_opened(pipe: Path, read: Callable[[Path], object]) -> None:
    for path in (pipe, pipe.parent, Path(os.devnull), Path("a\0b"), pipe.with_name("nothing")):
        with pytest.raises(OSError, match=r"\w"):
            read(path)


def test_pipes_among_a_recordings_pictures_are_missing(tmp_path: Path, pipe: Path) -> None:
    make_recording(tmp_path / "drive", CSV, [0, 1])
    broken = tmp_path / "drive" / "IMG" / picture_name("left", 1)
    broken.unlink()
    pipe.rename(broken)
    for done in recorded(tmp_path):
        assert (done.rows, done.pictures) == (2, 5)
        assert [name for _, name in done.skipped] == [broken.name]


def test_a_pipe_in_the_place_of_a_csv(tmp_path: Path, pipe: Path) -> None:
    make_recording(tmp_path / "drive", CSV)
    pipe.replace(tmp_path / "drive" / "driving_log.csv")
    with pytest.raises(RecordingError, match=r"no driving_log\.csv"):
        import_udacity(tmp_path / "drive", tmp_path / "log.mcap")


# Files that are all hole


def test_a_huge_picture_is_left_out_and_named(tmp_path: Path) -> None:
    make_recording(tmp_path / "drive", CSV, [0, 1])
    huge = with_hole(tmp_path / "drive" / "IMG" / picture_name("center", 0))
    for done in recorded(tmp_path):
        assert (done.rows, done.pictures) == (2, 5)
        assert list(done.skipped) == [("pictures that cannot be read", huge.name)]


def test_a_huge_csv_is_one_clear_line(tmp_path: Path) -> None:
    make_recording(tmp_path / "drive", CSV)
    with_hole(tmp_path / "drive" / "driving_log.csv")
    for record in (import_udacity, watch_udacity):
        with pytest.raises(RecordingError, match=r"driving_log\.csv: larger than 1 GB"):
            record(tmp_path / "drive", tmp_path / "log.mcap")


def test_huge_files_of_a_tub(tmp_path: Path) -> None:
    first = write_tub_1(tmp_path / "one", {number: record_1(number) for number in range(4)})
    with_hole(first / "record_1.json")
    with_hole(first / "2_cam-image_array_.jpg")
    done = import_recording(first, tmp_path / "one.mcap")
    assert done.rows == 2
    assert [name for _, name in done.skipped] == [
        "record_1.json",
        "2_cam-image_array_.jpg",
        "1_cam-image_array_.jpg",
    ]
    second = write_tub_2(tmp_path / "two", map(record_2, range(4)))
    with_hole(second / "manifest.json")
    with pytest.raises(RecordingError, match=r"manifest\.json: cannot be read \(larger than 17 MB\)"):
        import_recording(second, tmp_path / "two.mcap")


def test_a_huge_metadata_file_of_a_bag(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", StoragePlugin.MCAP)
    with_hole(bag / "metadata.yaml")
    with pytest.raises(RecordingError, match=r"metadata\.yaml cannot be read"):
        import_recording(bag, tmp_path / "log.mcap", ROS_TOPICS)


def test_metadata_of_a_bag_that_repeats_itself_without_end(tmp_path: Path) -> None:
    """Each mapping is merged twice into the next one: the last would have 2 to the power of 60."""
    merges = "".join(f"a{n + 1}: &a{n + 1} {{<<: [*a{n}, *a{n}], k{n}: 1}}\n" for n in range(60))
    bag = write_bag(tmp_path / "bag", StoragePlugin.MCAP)
    text = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(f"a0: &a0 {{k: 1}}\n{merges}{text}")
    assert import_recording(bag, tmp_path / "log.mcap", ROS_TOPICS).rows


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (b"[" * 30 + b"]" * 30, "deeper than 20 levels"),
        (b"- " * 100_000, "deeper than 20 levels"),
        (b"[" + b"[],\n" * 26_000 + b"]", "more than 50,000 events"),
    ],
    ids=["brackets", "dashes", "many"],
)
def test_yaml_is_bounded_in_depth_and_number(text: bytes, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        yaml_content(text)


def test_a_definition_of_thousands_of_fields_is_refused() -> None:
    fields = "".join(f"float32 field_{number}\n" for number in range(4000)).encode()
    assert len(fields) > 1 << 16
    with pytest.raises(RecordingError, match=f"the definition of its type has {len(fields):,} bytes"):
        decoder_for(Schema(1, fields, "ros2msg", "a/msg/B"), Channel(1, "/a", "cdr", {}, 1))


# ROS bags that are programs

ENDLESS = "WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c) SELECT n AS id, 1 AS topic_id,"
ENDLESS += (
    " n AS timestamp, x'00' AS data, '/cmd_vel' AS name, 'a/msg/B' AS type, 'cdr' AS serialization_format FROM c"
)


@pytest.mark.parametrize("table", ["messages", "topics"])
@pytest.mark.parametrize("doctored", [False, True], ids=["a view", "a view entered as a table"])
def test_a_view_in_the_place_of_a_bags_table_is_not_run(tmp_path: Path, table: str, doctored: bool) -> None:
    bag = write_bag(tmp_path / "bag", StoragePlugin.SQLITE3)
    database = sqlite3.connect(bag / "bag.db3")
    database.executescript(f"DROP TABLE {table}; CREATE VIEW {table.upper()} AS {ENDLESS};")
    if doctored:
        database.execute("PRAGMA writable_schema = ON")
        database.execute("UPDATE sqlite_master SET type = 'table' WHERE name = ?", (table.upper(),))
    database.commit()
    database.close()
    reported = "malformed" if doctored else f"{table} is not a table"  # the former by SQLite itself
    with pytest.raises(RecordingError, match=reported):
        import_recording(bag, tmp_path / "log.mcap", ROS_TOPICS)


# Logs that unpack to more than they are


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def write_packed(path: Path, messages: int, padding: bytes = b"") -> Path:
    """An unfinished log of one chunk with so many empty messages, a few kilobytes and the padding in all."""
    channel = record(4, struct.pack("<HH", 1, 0) + text(b"/x") + text(b"json") + text(b""))
    records = channel + record(5, struct.pack("<HIQQ", 1, 0, 5, 5)) * messages
    packed = zstandard.ZstdCompressor(9).compress(records)
    about = struct.pack("<QQQI", 5, 5, len(records), zlib.crc32(records)) + text(b"zstd")
    chunk = record(6, about + struct.pack("<Q", len(packed)) + packed)
    path.write_bytes(b"\x89MCAP0\r\n" + record(1, text(b"") + text(b"")) + record(0x80, padding) + chunk)
    return path


def run_with_memory(max_bytes: int, *arguments: object) -> subprocess.CompletedProcess[str]:
    """`bc-log` in a process that may take so much memory."""
    return subprocess.run(
        command("bc-log", *arguments),
        env=environment(),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_DATA, (max_bytes, max_bytes)),
    )


def test_a_log_of_more_messages_than_bytes_is_not_unpacked_into_memory(tmp_path: Path) -> None:
    path = write_packed(tmp_path / "packed.mcap", 2_000_000)
    assert path.stat().st_size < 10_000
    for name in ("info", "check"):
        done = run_with_memory(MEMORY_BYTES // 2, name, path)
        assert done.returncode == 3, done.stderr
        assert "Traceback" not in done.stderr
    with Log(path) as log:
        assert (log.counts, log.lost) == ({}, [(34, path.stat().st_size)])


def test_a_log_that_declares_more_messages_than_it_can_hold_is_refused(tmp_path: Path) -> None:
    def declare_many(record: McapRecord) -> None:
        if isinstance(record, Statistics):
            record.message_count = 10**15

    log = patched(write_log(tmp_path / "declares.mcap", [0.1] * 5), summary=declare_many)
    with pytest.raises(LogError, match=r"declares\.mcap: damaged: 1,000,000,000,000,000 messages in"):
        Log(log)
    assert recover(log, tmp_path / "saved.mcap").rows == 5


def test_trimming_takes_little_memory_for_each_message(tmp_path: Path) -> None:
    messages = 20_000
    log = tmp_path / "many.mcap"
    with log.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=1 << 22, compression=CompressionType.ZSTD)
        writer.start("bc", "somebody")
        channel = writer.register_channel("/vehicle", "protobuf", register_schema(writer, VehicleState))
        for row in range(messages):
            writer.add_message(channel, START_NS + row, b"", START_NS + row, row)
        writer.finish()  # type: ignore[no-untyped-call]
    tracemalloc.start()
    try:
        trim(log, tmp_path / "part.mcap", (0, 9))
        assert tracemalloc.get_traced_memory()[1] / messages < 300
    finally:
        tracemalloc.stop()


def png(side: int) -> bytes:
    """A black picture of `side` x `side`; few bytes, however large."""
    packer = zlib.compressobj(9)
    lines = b"".join(packer.compress(bytes(side // 8 + 2)) for _ in range(side)) + packer.flush()
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", side, side, 1, 0, 0, 0, 0)), (b"IDAT", lines), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


def test_a_picture_of_too_many_pixels_is_not_decoded() -> None:
    small = jpeg(100)
    at = small.index(b"\xff\xc0") + 5
    assert decodes(small)
    assert not decodes(small[:at] + b"\xff\xf0\xff\xf0" + small[at + 4 :])
    assert decodes(png(64))
    assert not decodes(png(8300))
    assert not decodes(png(64)[:20])


# What is skipped without end


def test_every_skipped_thing_is_in_the_log_but_not_in_memory(tmp_path: Path) -> None:
    make_recording(tmp_path / "drive", CSV + "junk\n" * 3000, [0, 1])
    done = import_udacity(tmp_path / "drive", tmp_path / "log.mcap")
    (reason,) = done.skipped.counts
    assert len(done.skipped) == 3000
    assert [name for _, name in done.skipped] == [f"line {number}" for number in range(3, 1003)]
    assert done.skipped.lines(2) == [f"{reason}: 3,000 (line 3, line 4, and 2,998 more)"]
    events = [(message.log_time, event.message) for message, event in read_messages(done.path)["/events"]]
    (_, (last, _)) = read_messages(done.path)["/vehicle"]
    assert events == [(last.log_time, f"skipped {reason}: line {number}") for number in range(3, 3003)]


def test_what_is_skipped_before_the_first_row_is_counted_in_the_log(tmp_path: Path) -> None:
    make_recording(tmp_path / "drive", "junk\n" * 1500 + CSV, [0, 1])
    done = import_udacity(tmp_path / "drive", tmp_path / "log.mcap")
    events = [event.message for _, event in read_messages(done.path)["/events"]]
    (reason,) = done.skipped.counts
    assert events == [*(f"skipped {reason}: line {n}" for n in range(1, 1001)), f"skipped {reason}: and 500 more"]


@pytest.mark.parametrize("rows", [3000, pytest.param(60_000, marks=pytest.mark.long)])
def test_importing_takes_no_memory_to_speak_of(tmp_path: Path, rows: int) -> None:
    """Up to a drive of five hours: a row costs its numbers and the names of its three pictures."""
    most = []
    for count in (1000, 1000 + rows):
        lines = (
            ",".join(
                f"/home/somebody/recording/IMG/{c}_2024_{1 + n // 20000:02d}_13_{n // 1000 % 20:02d}_"
                f"{n // 60 % 16:02d}_{n % 60:02d}_{n // 960 % 1000:03d}.jpg"
                for c in ("center", "left", "right")
            )
            + ",0.5,0.5,0,9.5\n"
            for n in range(count)
        )
        folder = tmp_path / str(count)
        make_recording(folder, CSV + "".join(lines), [0])
        tracemalloc.start()
        read = len(read_udacity(folder).rows)
        most.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert read == count + 2
    assert (most[1] - most[0]) / rows < 1000


# Names that are not UTF-8


def test_a_folder_and_pictures_whose_names_are_not_utf_8(tmp_path: Path) -> None:
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9"))
    try:
        make_recording(folder, CSV, [0, 1])
        (folder / "IMG" / os.fsdecode(b"\xe9.jpg")).write_bytes(b"")
    except OSError:
        pytest.skip("names that are not UTF-8 were not tried: the file system has none")
    for flags in ([], ["--watch", "--idle", "0"]):
        name = f"a{len(flags)}"
        done = run("bc-import", folder, name, *flags, cwd=tmp_path)
        assert done.returncode == 3, done.stderr
        assert r"skipped pictures without a row: 1 (\udce9.jpg)" in done.stderr.splitlines()
        messages = read_messages(tmp_path / "sessions" / f"{name}.mcap")
        assert (len(messages["/vehicle"]), len(messages["/camera/left"]), len(messages["/events"])) == (2, 2, 1)
