"""What the index makes of tags, of logs that share pictures, and of unfinished and compressed ones."""

from __future__ import annotations

import os
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from common.car import Camera
from dataset import DatasetError, IndexConfig, Loader, Samples, build_index, find_logs
from dataset.cli import main
from recorder import Log, LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log.tags import Tag, add_tags, remove_tags
from recorder.upkeep.edit import trim
from recorder.upkeep.recover import recover
from tests.helpers.layouts import Layout, mixed, two_kinds
from tests.helpers.logs import START_NS, STEP_NS, write_log
from tests.helpers.places import Place
from tests.helpers.udacity import call, jpeg

STEERING = [round(0.02 * (row % 40) - 0.4, 2) for row in range(120)]  # 12 s


def picture(camera: Camera, row: int) -> bytes:
    return jpeg(60 + row, row)


def tag(path: Path, name: str, first_row: int, last_row: int, *, remove: bool = False) -> None:
    with Log(path) as log:
        (remove_tags if remove else add_tags)(path, log.fingerprint, [Tag(first_row, last_row, name)])


def compress(path: Path, to: Path, compression: CompressionType) -> Path:
    """The same messages in compressed chunks, by mcap alone."""
    with path.open("rb") as source, to.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=20_000, compression=compression)
        writer.start("bc")
        numbers: dict[str, int] = {}
        for schema, channel, message in make_reader(source).iter_messages(log_time_order=False):
            assert schema is not None
            if channel.topic not in numbers:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, number)
            writer.add_message(
                numbers[channel.topic], message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.finish()  # type: ignore[no-untyped-call]
    return to


def test_rows_marked_bad_in_an_unfinished_log_are_never_trained_on(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, {"source": "test"}) as writer:
        for row, steering in enumerate(STEERING):
            writer.picture("center", START_NS + row * STEP_NS, row, picture("center", row))
            writer.vehicle(START_NS + row * STEP_NS, row, VehicleState(steering=steering, speed_mph=9.0))
        writer.event(START_NS, "driven badly: rows 10 to 19")
    os.truncate(path, path.stat().st_size - 1)
    rows = set(build_index([path], tmp_path / "index").samples["row"].to_pylist())
    assert rows
    assert rows.isdisjoint(range(10, 20))


def test_excluded_rows_are_never_trained_on_and_every_tag_is_a_column(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", STEERING)
    tag(path, "exclude", 10, 19)
    tag(path, "recovery", 15, 30)
    indexed = build_index([path], tmp_path / "index")
    frames = pq.read_table(tmp_path / "index" / "frames" / "a.parquet")
    tags = dict(zip(frames["row"].to_pylist(), frames["tags"].to_pylist(), strict=True))
    for row in range(120):
        assert tags[row] == ["exclude"] * (10 <= row <= 19) + ["recovery"] * (15 <= row <= 30)
    rows = set(indexed.samples["row"].to_pylist())
    assert rows.isdisjoint(range(10, 20))
    assert set(range(20, 31)) & rows


def test_a_new_or_a_removed_tag_is_noticed(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", STEERING)
    index = tmp_path / "index"
    assert build_index([path], index).read == ["a"]
    tag(path, "exclude", 0, 5)
    assert build_index([path], index).read == ["a"]
    assert build_index([path], index).read == []
    tag(path, "exclude", 0, 5, remove=True)
    again = build_index([path], index)
    assert again.read == ["a"]
    assert 3 in again.samples["row"].to_pylist()


def test_tags_of_another_recording_of_that_name_do_not_count(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", STEERING)
    tag(path, "exclude", 0, 119)
    write_log(path, STEERING[::-1], overwrite=True)
    assert len(build_index([path], tmp_path / "index").samples)


def test_a_log_beside_a_part_of_it_is_refused_until_one_is_excluded(tmp_path: Path, place: Place) -> None:
    whole = write_log(tmp_path / "a.mcap", STEERING)
    part = trim(whole, tmp_path / "b.mcap", (50, 69)).path
    with pytest.raises(DatasetError, match=r"a\.mcap and .*b\.mcap: the same picture.*exclude"):
        build_index([place(whole), place(part)], tmp_path / "index")
    tag(whole, "exclude", 50, 69)
    indexed = build_index([place(whole), place(part)], tmp_path / "index")
    assert set(indexed.samples["session"].to_pylist()) == {"a", "b"}


@pytest.mark.parametrize("layout", [two_kinds, mixed])
def test_an_unfinished_log_is_indexed_as_far_as_it_goes_and_said_so(
    tmp_path: Path,
    place: Place,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    layout: Layout,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", 1000)  # rows are written every few of them
    whole = layout(write_log(tmp_path / "whole.mcap", STEERING, picture))
    (tmp_path / "sessions").mkdir()
    cut = tmp_path / "sessions" / "lake.mcap"
    cut.write_bytes(whole.read_bytes())
    os.truncate(cut, whole.stat().st_size * 3 // 4)
    assert call(main, "--sessions", place(tmp_path / "sessions")) == 3
    printed = capsys.readouterr()
    assert "lake.mcap: unfinished" in printed.err
    assert "bc-log recover" in printed.err
    frames = pq.read_table("index/frames/lake.parquet")
    recovered = recover(cut, tmp_path / "recovered.mcap")
    assert 0 < len(set(frames["row"].to_pylist())) <= recovered.rows < 120


def test_a_recording_that_was_killed_is_pointed_out(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_log(cwd / "sessions" / "lake.mcap", STEERING)
    killed = cwd / "sessions" / "jungle.mcap.0a1b2c.part"
    killed.write_bytes(b"\x89MCAP0\r\n")
    assert call(main) == 3
    assert "jungle.mcap.0a1b2c.part: not indexed" in capsys.readouterr().err
    assert find_logs([str(killed)], Path("sessions")) == [killed]


def test_one_log_that_cannot_be_read_is_left_out_and_named(
    cwd: Path, place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    write_log(cwd / "sessions" / "lake.mcap", STEERING)
    (cwd / "sessions" / "bad.mcap").write_bytes(b"no log")
    assert call(main, "--sessions", place(cwd / "sessions")) == 3
    printed = capsys.readouterr()
    assert "bad.mcap: not an MCAP log" in printed.err
    assert set(pq.read_table("index/samples.parquet")["session"].to_pylist()) == {"lake"}
    assert (
        call(main, "lake", "bad", "--sessions", place(cwd / "sessions")) == 1
    )  # asked for by name, it is an error
    (cwd / "sessions" / "lake.mcap").unlink()
    assert call(main, "--sessions", place(cwd / "sessions")) == 1


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_compressed_log_trains_on_the_same_pictures(tmp_path: Path, compression: CompressionType) -> None:
    plain = write_log(tmp_path / "plain" / "lake.mcap", STEERING, picture)
    (tmp_path / "packed").mkdir()
    packed = compress(plain, tmp_path / "packed" / "lake.mcap", compression)
    batches = []
    for path in (plain, packed):
        build_index([path], path.parent / "index", IndexConfig(block_s=2.0))
        samples = Samples(path.parent / "index")
        batches.append(list(Loader(samples, samples.of_split("train"), batch=50).in_order()))
        samples.close()
    assert len(batches[0]) == len(batches[1]) > 1
    for expected, batch in zip(*batches, strict=True):
        assert (expected.pictures == batch.pictures).all()
        assert (expected.steering == batch.steering).all()
