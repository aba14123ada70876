"""New logs out of old ones hold what they should, message by message, and other programs find nothing wrong."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log as LogMessage
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from mcap.writer import CompressionType

from common import UserError
from common.car import CAMERAS
from common.versions import version_of
from recorder import Log, LogError, LogWriter
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.log.tags import Tag, add_tags, tags_path
from recorder.topics import ROW_TOPICS
from recorder.upkeep.edit import merge, rows_between, split, trim, trim_times
from recorder.upkeep.recover import recover
from tests.helpers.layouts import Layout, mixed, two_kinds
from tests.helpers.logs import START_NS, STEP_NS, flip_bit, not_a_picture, tags_of
from tests.helpers.plain_mcap import Contents, Stored, by_topic, contents, plain_writer, write_plain

SECOND_NS = 1_000_000_000
VERSION = version_of()


def drive(
    path: Path, rows: Iterable[int], *, gap_after: int | None = None, name: str = "", begins: str = "begin "
) -> Path:
    """A drive with every kind of message; the events `begin` and `end` lie outside of its rows' time."""
    with LogWriter(path, {"source": "test", "driver": name or path.stem}) as writer:
        writer.event(START_NS - 1, f"{begins}{name}")
        for row in rows:
            time_ns = START_NS + row * STEP_NS
            if gap_after is not None and row > gap_after:
                time_ns += 10 * SECOND_NS
            for camera in CAMERAS:
                writer.picture(camera, time_ns, row, f"{name} {not_a_picture(camera, row)!r}".encode())
            writer.vehicle(time_ns, row, VehicleState(steering=row / 100, throttle=0.5, speed_mph=9.0))
            writer.crop(time_ns, row, b"\x89PNG\r\n\x1a\n" + bytes([row]))
            writer.command(time_ns, row, PilotCommand(steering=row / 50))
            writer.pose(time_ns, row, PoseInFrame(frame_id="world"))
            writer.event(time_ns, f"at row {row}")
        writer.event(time_ns + 1, f"end {name}")
        writer.add_metadata("bc.run", {"sha256": "abc"})
    return laid_out(path)


def killed(whole: Path) -> tuple[Path, list[Stored]]:
    """What a kill leaves of this log, and the messages that are in it."""
    content = contents(whole)
    path = whole.with_name(f"{whole.name}.0a1b2c.part")
    last = content.chunks[-1]
    path.write_bytes(whole.read_bytes()[: last.end - 1])
    return path, [message for chunk in content.chunks[:-1] for message in chunk.messages]


def events_in(content: Contents) -> list[str]:
    return [LogMessage.FromString(message.data).message for message in content.of("/events")]


def numbered_on(messages: list[Stored], first: int) -> list[Stored]:
    return [m._replace(sequence=m.sequence + first) if m.topic in ROW_TOPICS else m for m in messages]


def tag(path: Path, *tags: tuple[int, int, str]) -> Path:
    with Log(path) as log:
        for tag in tags:
            add_tags(path, log.fingerprint, [Tag(*tag)])
    return path


CHUNK_BYTES = 2100
"""These chunks end within rows, and none between a row's pose and its other messages: a row that has only lost its
pose is kept."""


BOTH_LAYOUTS = pytest.mark.parametrize("layout", ["two kinds", "mixed"], indirect=True)


@pytest.fixture(autouse=True)
def layout(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The layout of logs that are edited; those that are written have the one of today."""
    monkeypatch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", CHUNK_BYTES)
    if getattr(request, "param", "two kinds") == "mixed":
        monkeypatch.setattr(f"{__name__}.laid_out", partial(mixed, chunk_bytes=CHUNK_BYTES))


laid_out: Layout = two_kinds


# Recover


@BOTH_LAYOUTS
def test_a_recovered_log_is_the_original_message_by_message(tmp_path: Path) -> None:
    whole = drive(tmp_path / "a.mcap", range(20))
    done = recover(whole, tmp_path / "b.mcap")
    original, content = contents(whole), contents(done.path)
    assert content.by_topic == original.by_topic
    assert (done.messages, done.rows, list(done.skipped)) == (len(original.messages), 20, [])
    assert content.profile == "bc"
    session = {**dict(original.metadata)["bc.session"], "recovered_from": "a.mcap", "rewritten_by": VERSION}
    assert sorted(content.metadata) == sorted({**dict(original.metadata), "bc.session": session}.items())


@BOTH_LAYOUTS
def test_an_unfinished_log_is_recovered_up_to_its_last_whole_chunk(tmp_path: Path) -> None:
    part, complete = killed(drive(tmp_path / "a.mcap", range(20)))
    done = recover(part, tmp_path / "b.mcap")
    rows = [message.sequence for message in complete if message.topic == "/vehicle"]
    begun = [m for m in complete if m.topic in ROW_TOPICS and m.sequence > max(rows)]
    assert begun
    assert contents(done.path).by_topic == by_topic(message for message in complete if message not in begun)
    assert done.rows == len(rows)
    *unfinished, (reason, where) = done.skipped
    assert unfinished == [
        ("messages of a row that was never finished", f"{m.topic} row {m.sequence}") for m in begun
    ]
    assert reason == "stretches of unreadable bytes"
    assert where.endswith(f" to {part.stat().st_size:,}")


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_compressed_log_of_another_program_is_recovered_uncompressed(
    tmp_path: Path, compression: CompressionType
) -> None:
    path = write_plain(tmp_path / "a.mcap", compression, range(20))
    done = recover(path, tmp_path / "b.mcap")
    assert contents(done.path).messages == contents(path).messages
    assert contents(done.path).profile == ""
    with Log(done.path) as log:
        assert {chunk.compression for chunk in log.chunks} == {""}


def test_attachments_and_messages_without_a_schema_are_recovered_too(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with plain_writer(path) as writer:
        channel = writer.register_channel("/json", "json", 0)
        writer.add_message(channel, 1, b"{}", 2, 3)
        writer.add_attachment(4, 5, "notes.txt", "text/plain", b"hello")
    content = contents(recover(path, tmp_path / "b.mcap").path)
    assert content.messages == [Stored("/json", "", 3, 1, 2, b"{}")]
    assert content.attachments == [("notes.txt", b"hello")]


def test_a_state_that_cannot_be_decoded_costs_a_recovery_nothing_else(tmp_path: Path) -> None:
    path, data = tmp_path / "a.mcap", VehicleState(steering=0.1).SerializeToString()
    with plain_writer(path, "bc") as writer:
        schema = writer.register_schema("bc.VehicleState", "protobuf", b"")
        channel = writer.register_channel("/vehicle", "protobuf", schema)
        for row in range(5):
            writer.add_message(channel, START_NS + row, b"\xff" if row == 2 else data, START_NS + row, row)
    with pytest.raises(LogError, match=r"b\.mcap: cannot be made: row 2 .*`bc-log recover` leaves it out"):
        trim(path, tmp_path / "b.mcap", (0, 4))
    done = recover(path, tmp_path / "b.mcap")
    assert (done.rows, list(done.skipped)) == (4, [("messages that do not match their schema", "/vehicle row 2")])
    assert [message.sequence for message in contents(done.path).messages] == [0, 1, 3, 4]


# Trim


@BOTH_LAYOUTS
def test_a_trimmed_log_holds_its_rows_and_the_events_between_them(tmp_path: Path) -> None:
    whole = drive(tmp_path / "a.mcap", range(20))
    done = trim(whole, tmp_path / "b.mcap", (5, 8))
    content = contents(done.path)
    times = range(START_NS + 5 * STEP_NS, START_NS + 8 * STEP_NS + 1)
    assert content.by_topic == by_topic(m for m in contents(whole).messages if m.log_time in times)
    assert (done.messages, done.rows) == (4 * 8, 4)
    assert events_in(content) == [f"at row {row}" for row in range(5, 9)]
    assert dict(content.metadata)["bc.session"].items() >= {"trimmed_from": "a.mcap", "rows": "5-8"}.items()
    assert dict(content.metadata)["bc.quality"]["rows"] == "4"


@BOTH_LAYOUTS
def test_an_unfinished_log_can_be_trimmed(tmp_path: Path) -> None:
    part, complete = killed(drive(tmp_path / "a.mcap", range(20)))
    done = trim(part, tmp_path / "b.mcap", (2, 4))
    expected = [m for m in complete if m.topic in ROW_TOPICS and 2 <= m.sequence <= 4]
    assert by_topic(m for m in contents(done.path).messages if m.topic in ROW_TOPICS) == by_topic(expected)


def test_rows_that_are_not_there_are_reported_with_those_that_are(tmp_path: Path) -> None:
    whole = drive(tmp_path / "a.mcap", range(3, 9))
    with pytest.raises(LogError, match=r"a\.mcap: no row from 9 to 12; its rows are 3 to 8"):
        trim(whole, tmp_path / "b.mcap", (9, 12))
    assert not (tmp_path / "b.mcap").exists()


def test_seconds_count_from_the_first_row(tmp_path: Path) -> None:
    with Log(drive(tmp_path / "a.mcap", range(3, 20))) as log:
        assert rows_between(log, 0.0, 0.5) == (3, 8)
        assert rows_between(log, 0.45, 1e9) == (8, 19)
        with pytest.raises(LogError, match=r"no row between 7 and 9 s; it lasts 1\.6 s"):
            rows_between(log, 7, 9)
        with pytest.raises(LogError, match="no row between nan"):
            rows_between(log, float("nan"), 9)


def foreign(path: Path) -> Path:
    """Another program's log: ten messages, a tenth of a second apart, of no topic that we know."""
    with plain_writer(path, "other", "other", chunk_size=100) as writer:
        channel = writer.register_channel("/tf", "json", writer.register_schema("tf", "jsonschema", b"{}"))
        for number in range(10):
            time_ns = START_NS + number * STEP_NS
            writer.add_message(channel, time_ns, b"%d" % number, time_ns, number)
        writer.add_metadata("calibration", {"k": "1"})
    return path


def test_a_log_of_another_program_is_trimmed_by_time_alone(tmp_path: Path) -> None:
    path = foreign(tmp_path / "tf.mcap")
    content = contents(trim_times(path, tmp_path / "b.mcap", 0.2, 0.45).path)
    assert [message.data for message in content.messages] == [b"2", b"3", b"4"]
    assert content.metadata == [("calibration", {"k": "1"})]
    with pytest.raises(LogError, match=r"tf\.mcap: no message of these times; it lasts 0\.9 s"):
        trim_times(path, tmp_path / "c.mcap", 5, 6)
    with pytest.raises(LogError, match=r"tf\.mcap: no rows in it .* `bc-log trim` takes times"):
        trim(path, tmp_path / "c.mcap", (0, 1))
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["b.mcap", "tf.mcap"]


@BOTH_LAYOUTS
def test_seconds_of_a_log_with_rows_are_those_of_its_rows(tmp_path: Path) -> None:
    whole = drive(tmp_path / "a.mcap", range(3, 20))
    by_time = trim_times(whole, tmp_path / "b.mcap", 0.45, 1.0)
    by_rows = trim(whole, tmp_path / "c.mcap", (8, 13))
    assert contents(by_time.path).by_topic == contents(by_rows.path).by_topic
    assert (by_time.rows, by_time.messages) == (by_rows.rows, by_rows.messages)


# Merge


@BOTH_LAYOUTS
def test_a_merged_log_holds_all_in_order_with_row_numbers_of_its_own(tmp_path: Path) -> None:
    logs = [drive(tmp_path / f"{name}.mcap", rows, name=name) for name, rows in NAMED_ROWS.items()]
    done = merge(logs, tmp_path / "all.mcap")
    one, two, three = (contents(log).messages for log in logs)
    content = contents(done.path)
    assert content.by_topic == by_topic([*one, *numbered_on(two, 20), *numbered_on(three, 35)])
    numbers = [message.sequence for message in content.of("/vehicle")]
    assert len(set(numbers)) == len(numbers) == done.rows == 20 + 10 + 5
    assert {name for name, _ in content.metadata} >= {"bc.session of one.mcap", "bc.session of three.mcap"}
    with Log(done.path) as log:
        for name, row in (("one", 0), ("two", 25), ("three", 35)):
            own = row - {"one": 0, "two": 20, "three": 35}[name]
            assert log.picture(row, "left") == f"{name} {not_a_picture('left', own)!r}".encode()


NAMED_ROWS = {"one": range(20), "two": range(5, 15), "three": range(5)}


# Split


@BOTH_LAYOUTS
def test_each_drive_becomes_a_log_and_no_message_is_lost(tmp_path: Path) -> None:
    whole = drive(tmp_path / "a.mcap", range(20), gap_after=11)
    done = split(whole, tmp_path / "drives")
    assert [written.path.name for written in done] == ["a-1.mcap", "a-2.mcap"]
    first, second = (contents(written.path) for written in done)
    assert by_topic(first.messages + second.messages) == contents(whole).by_topic
    assert [message.sequence for message in first.of("/vehicle")] == list(range(12))
    assert (events_in(first)[0], events_in(second)[-1]) == ("begin ", "end ")
    assert [(w.rows, w.messages) for w in done] == [(12, len(first.messages)), (8, len(second.messages))]
    assert dict(second.metadata)["bc.session"].items() >= {"split_from": "a.mcap", "drive": "1"}.items()


def test_what_was_merged_is_split_again_where_time_goes_back(tmp_path: Path) -> None:
    logs = [drive(tmp_path / f"{name}.mcap", rows, name=name) for name, rows in NAMED_ROWS.items()]
    parts = split(merge(logs, tmp_path / "all.mcap").path, tmp_path)
    assert [part.rows for part in parts] == [20, 10, 5]
    messages = Counter(message for part in parts for message in contents(part.path).messages)
    assert messages == Counter(contents(tmp_path / "all.mcap").messages)


def test_a_single_drive_is_not_split(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"a\.mcap: has a single drive"):
        split(drive(tmp_path / "a.mcap", range(5)), tmp_path / "drives")
    assert not (tmp_path / "drives").exists()


# Tags


def test_rows_marked_bad_in_an_unfinished_log_are_tagged_in_new_ones(tmp_path: Path) -> None:
    whole = drive(tmp_path / "a.mcap", range(20), gap_after=5, begins="driven badly: rows 3 to 7")
    part, _ = killed(whole)
    trim(part, tmp_path / "trimmed.mcap", (2, 4))
    assert tags_of(tmp_path / "trimmed.mcap") == [(3, 4, "exclude")]
    merge([part, whole], tmp_path / "merged.mcap")  # a finished log has its tags in a file
    assert tags_of(tmp_path / "merged.mcap") == [(3, 7, "exclude")]
    first, second = split(part, tmp_path / "drives")
    assert (tags_of(first.path), tags_of(second.path)) == ([(3, 5, "exclude")], [(6, 7, "exclude")])


def test_tags_go_where_their_rows_go(tmp_path: Path) -> None:
    whole = tag(
        drive(tmp_path / "a.mcap", range(20), gap_after=11),
        (0, 30, "exclude"),
        (8, 15, "recovery"),
        (2, 3, "bend"),
    )
    trim(whole, tmp_path / "trimmed.mcap", (3, 10))
    assert tags_of(tmp_path / "trimmed.mcap") == [(3, 3, "bend"), (3, 10, "exclude"), (8, 10, "recovery")]
    trim_times(whole, tmp_path / "times.mcap", 0.3, 1.0)
    assert tags_of(tmp_path / "times.mcap") == tags_of(tmp_path / "trimmed.mcap")
    first, second = split(whole, tmp_path / "drives")
    assert tags_of(first.path) == [(0, 11, "exclude"), (2, 3, "bend"), (8, 11, "recovery")]
    assert tags_of(second.path) == [(12, 15, "recovery"), (12, 19, "exclude")]
    merge([second.path, first.path, second.path], tmp_path / "merged.mcap")
    assert tags_of(tmp_path / "merged.mcap") == [
        (12, 15, "recovery"),
        (12, 19, "exclude"),
        (20, 31, "exclude"),
        (22, 23, "bend"),
        (28, 31, "recovery"),
        (32 + 12, 32 + 15, "recovery"),
        (32 + 12, 32 + 19, "exclude"),
    ]
    recover(whole, tmp_path / "recovered.mcap")
    assert tags_of(tmp_path / "recovered.mcap") == [(0, 19, "exclude"), (2, 3, "bend"), (8, 15, "recovery")]


@BOTH_LAYOUTS
def test_a_damaged_log_keeps_its_tags_when_it_is_recovered(tmp_path: Path) -> None:
    """Whichever chunk is damaged; they are cut to the rows that are left."""
    whole = tag(drive(tmp_path / "a.mcap", range(20)), (0, 19, "exclude"))
    data, to = whole.read_bytes(), tmp_path / "b.mcap"
    for chunk in contents(whole).chunks:
        whole.write_bytes(data)
        flip_bit(whole, chunk.end - 1)
        tags_path(to).unlink(missing_ok=True)
        recover(whole, to, overwrite=True)
        rows = [message.sequence for message in contents(to).of("/vehicle")]
        assert tags_of(to) == [(min(rows), max(rows), "exclude")], chunk.start


def test_tags_of_missing_rows_and_other_content_do_not_come_along(tmp_path: Path) -> None:
    whole = tag(drive(tmp_path / "a.mcap", range(20)), (0, 5, "bend"))
    trim(whole, tmp_path / "b.mcap", (6, 10))
    drive(tmp_path / "c.mcap", range(20), name="recorded anew")
    tags_path(whole).rename(tags_path(tmp_path / "c.mcap"))
    trim(tmp_path / "c.mcap", tmp_path / "d.mcap", (0, 10))
    assert not list(tmp_path.glob("[bd].tags.jsonl"))


def test_damaged_tags_stop_all_but_a_recovery_which_names_them(tmp_path: Path) -> None:
    whole = drive(tmp_path / "a.mcap", range(20), gap_after=11)
    tags_path(whole).write_text("exclude 3 5\n")
    edits: list[Edit] = [EDITS["trim"], EDITS["merge"], lambda path, to, force: split(path, to, overwrite=force)]
    for edit in edits:
        with pytest.raises(LogError, match=r"a\.tags\.jsonl: line 1 is not a tag"):
            edit(whole, tmp_path / "b.mcap", False)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap", "a.tags.jsonl"]
    done = recover(whole, tmp_path / "b.mcap")
    assert done.skipped.counts == {"damaged files of tags": 1}


# All of them

Edit = Callable[[Path, Path, bool], object]
EDITS: dict[str, Edit] = {
    "recover": lambda path, to, force: recover(path, to, overwrite=force),
    "trim": lambda path, to, force: trim(path, to, (0, 3), overwrite=force),
    "merge": lambda path, to, force: merge([path, path], to, overwrite=force),
}


@pytest.mark.parametrize("edit", EDITS.values(), ids=EDITS)
def test_nothing_is_overwritten_and_the_original_never_changes(tmp_path: Path, edit: Edit) -> None:
    whole, other = drive(tmp_path / "a.mcap", range(5)), tmp_path / "b.mcap"
    before = whole.read_bytes()
    other.write_bytes(b"somebody's work")
    with pytest.raises(UserError, match=r"b\.mcap exists already.*--force"):
        edit(whole, other, False)
    assert other.read_bytes() == b"somebody's work"
    with pytest.raises(LogError, match=r"a\.mcap: is the log itself"):
        edit(whole, whole, True)
    link = tmp_path / "link.mcap"
    link.symlink_to(whole)
    with pytest.raises(LogError, match=r"link\.mcap: is the log itself"):
        edit(whole, link, True)
    edit(whole, other, True)
    assert contents(other).messages
    assert whole.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap", "b.mcap", "link.mcap"]


def test_split_overwrites_nothing_either(tmp_path: Path) -> None:
    whole = drive(tmp_path / "a.mcap", range(20), gap_after=11)
    before = whole.read_bytes()
    (tmp_path / "a-2.mcap").write_bytes(b"somebody's work")
    with pytest.raises(UserError, match=r"a-2\.mcap exists already"):
        split(whole, tmp_path)
    assert (tmp_path / "a-2.mcap").read_bytes() == b"somebody's work"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a-2.mcap", "a.mcap"]
    assert len(split(whole, tmp_path, overwrite=True)) == 2
    assert whole.read_bytes() == before


def test_a_new_log_shows_both_versions_that_made_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("recorder.log.writer.version_of", lambda: "0.0.1")
        whole = drive(tmp_path / "a.mcap", range(20), gap_after=5)
    recover(whole, tmp_path / "b.mcap")
    trim(whole, tmp_path / "c.mcap", (0, 3))
    for path in (tmp_path / "b.mcap", tmp_path / "c.mcap", split(whole, tmp_path)[1].path):
        with Log(path) as log:
            assert (log.metadata["toolkit"], log.metadata["rewritten_by"]) == ("0.0.1", VERSION)


@BOTH_LAYOUTS
@pytest.mark.parametrize("edit", [EDITS["trim"], EDITS["merge"]], ids=["trim", "merge"])
def test_a_damaged_log_is_not_edited_by_halves(tmp_path: Path, edit: Edit) -> None:
    path = drive(tmp_path / "a.mcap", range(20))
    flip_bit(path, contents(path).chunks[3].end - 1)
    with pytest.raises(LogError, match=r"a\.mcap: damaged.*bc-log recover"):
        edit(path, tmp_path / "b.mcap", False)
    assert list(tmp_path.iterdir()) == [path]
