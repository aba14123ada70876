"""What of a log is handed to Rerun: every message as it was written, and nothing of a damaged chunk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap_protobuf.schema import build_file_descriptor_set
from rerun.chunk import McapReader

from recorder import LogWriter
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.log.writer import pose_message
from simulator.pose import Pose
from tests.helpers.driving import one_line_of, road_jpeg, run
from tests.helpers.layouts import is_of_pictures, write_as_before
from tests.helpers.logs import START_NS, STEP_NS
from tests.helpers.plain_mcap import StoredChunk
from tests.helpers.plain_mcap import contents as plain_contents
from tests.helpers.rrd import contents
from tests.helpers.udacity import call
from viz.cli import main

ROWS = 60
CHUNK_BYTES = 20_000  # some rows each
CAMERAS = ("/camera/center", "/camera/left", "/pilot/input")
Entities = dict[str, dict[str, list[Any]]]


@pytest.fixture(autouse=True)
def _small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", CHUNK_BYTES)


def write_drive(path: Path) -> Path:
    """All topics that a drive has, and some that only Rerun's own reader knows."""
    with LogWriter(path, {"source": "test", "track": "a field"}) as log:
        for row in range(ROWS):
            time_ns = START_NS + row * STEP_NS
            log.picture("center", time_ns, row, picture("/camera/center", row))
            log.picture("left", time_ns, row, picture("/camera/left", row))
            log.crop(time_ns, row, picture("/pilot/input", row))
            log.vehicle(time_ns, row, VehicleState(steering=row / 100, speed_mph=9.0))
            log.command(time_ns, row, PilotCommand(steering=row / 200, driver=PilotCommand.PILOT))
            log.pose(time_ns, row, pose_message(Pose(row, 2.0 * row, 0.5, 0.1, 0.0, 0.0), time_ns))
            if row % 20 == 0:
                log.event(time_ns, f"row {row}", "WARNING")
        pixels = RawImage(width=2, height=1, encoding="rgb8", step=6, data=b"abcdef")
        copy(log, "/map", pixels)
        copy(log, "/camera/behind me", CompressedImage(data=picture("behind", 7), format="png"))
    return path


def copy(log: LogWriter, topic: str, message: Any) -> None:
    """A message of a topic that the toolkit does not know."""
    kinds = build_file_descriptor_set(type(message)).SerializeToString()
    schema = Schema(id=7, data=kinds, encoding="protobuf", name=message.DESCRIPTOR.full_name)
    channel = Channel(id=7, topic=topic, message_encoding="protobuf", metadata={}, schema_id=7)
    log.copy(schema, channel, Message(7, START_NS, message.SerializeToString(), START_NS, 0), 0)


def picture(topic: str, row: int) -> bytes:
    """A real JPEG, with its topic and row behind its end, by which it is found anywhere."""
    return road_jpeg(row) + f"<{topic} row {row}>".encode()


def layouts(folder: Path) -> dict[str, Path]:
    new = write_drive(folder / "drive.mcap")
    return {"new": new, "old": write_as_before(new, folder / "old.mcap", CHUNK_BYTES)}


@pytest.fixture(params=["new", "old"])
def log(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return layouts(tmp_path)[request.param]


def shown(log: Path) -> Entities:
    rrd = log.with_suffix(".rrd")
    assert call(main, log, "--save", rrd) == 0
    return contents(rrd)


def blobs(entities: Entities, topic: str) -> list[bytes]:
    return [bytes(blob[0]) for blob in entities.get(topic, {}).get("EncodedImage:blob", []) if blob]


def test_every_picture_is_shown_at_its_time_as_mcaps_own_reader_finds_it(log: Path) -> None:
    entities = shown(log)
    with log.open("rb") as stream:
        messages = [
            (channel.topic, message.log_time, CompressedImage.FromString(message.data))
            for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages()
            if schema is not None and schema.name == "foxglove.CompressedImage"
        ]
    assert len(messages) == 3 * ROWS + 1
    for topic in {topic for topic, *_ in messages}:
        entity = entities[topic.replace(" ", "\\ ")]
        expected = [(time, image) for name, time, image in messages if name == topic]
        assert [bytes(blob[0]) for blob in entity["EncodedImage:blob"]] == [image.data for _, image in expected]
        kinds = [f"image/{image.format}" for _, image in expected]
        assert entity["EncodedImage:media_type"] == [[kind] for kind in kinds]
        assert entity["message_log_time"] == [time for time, _ in expected]
        since_start = [time.value for time in entity["since start"]]
        assert since_start == [time - START_NS for time, _ in expected]


def test_all_else_is_shown_as_reruns_own_reader_shows_it(log: Path) -> None:
    entities, own = shown(log), reruns(log)
    for entity in ("/map", "/pose", "/events", "/__mcap_metadata", "/__mcap_properties"):
        # a frame of its own would only keep the pose out of views of the other entities
        names = {
            name
            for name in own[entity]
            if name.split(":")[0] not in ("McapChannel", "McapSchema", "CoordinateFrame")
        }
        for name in names - {"message_publish_time", "timestamp"}:
            assert entities[entity][name] == own[entity][name], (entity, name)
    for entity in ("/map", *CAMERAS):
        names = {name for name in own[entity] if name.startswith(("McapChannel", "McapSchema"))}
        assert names
        assert {name: entities[entity][name] for name in names} == {name: own[entity][name] for name in names}


def reruns(log: Path) -> Entities:
    """What Rerun makes of a log by itself."""
    entities: Entities = {}
    for chunk in McapReader(log).stream():
        batch = chunk.to_record_batch()
        entity = entities.setdefault(str(chunk.entity_path), {})
        for name in batch.schema.names:
            if name != "rerun.controls.RowId":
                column = batch.column(name)
                in_ns = column.cast("int64") if str(column.type).startswith("timestamp") else column
                entity.setdefault(name, []).extend(in_ns.to_pylist())
    return entities


def picture_chunks(log: Path) -> list[StoredChunk]:
    return [chunk for chunk in plain_contents(log).chunks if is_of_pictures(chunk.messages[0].topic)]


def damage(log: Path, chunk: StoredChunk, how: str) -> list[str]:
    """Damage a chunk; the names of its pictures."""
    data = bytearray(log.read_bytes())
    if how == "a picture":
        message = chunk.messages[0]
        at = data.index(message.data, chunk.start) + len(message.data) - 1
        data[at] ^= 1
    elif how == "a length":
        data[chunk.start + 49 + 1 + 4] ^= 0x40  # of its first record
    elif how == "its header":
        data[chunk.start : chunk.start + 9] = bytes(9)
    else:
        data[chunk.start : chunk.end] = bytes(chunk.end - chunk.start)
    log.write_bytes(data)
    return [f"{message.topic} row {message.sequence}" for message in chunk.messages]


@pytest.mark.parametrize(
    ("how", "number"),
    [
        ("a picture", 0),
        ("a picture", -2),
        ("a length", 3),
        ("its header", 0),
        ("its header", -2),
        ("all of it", 3),
    ],
)
def test_a_damaged_chunk_of_pictures_is_left_out_and_reported(
    tmp_path: Path, how: str, number: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "1000")
    log, rrd = write_drive(tmp_path / "drive.mcap"), tmp_path / "drive.rrd"
    sound = shown(log)
    lost = damage(log, picture_chunks(log)[number], how)
    assert 2 < len(lost) < ROWS
    rrd.unlink()
    capsys.readouterr()
    assert call(main, log, "--save", rrd) == 3
    printed = capsys.readouterr()
    line, step = printed.err.splitlines()
    assert step.endswith(f"rerun {rrd}`")
    assert line.startswith(f"bc-play: skipped pictures in damaged chunks of {log} ")
    assert f"`bc-log recover {log}`" in line
    assert f": {len(lost)} ({lost[0]}, " in line
    assert "written" in printed.out
    entities, written = contents(rrd), rrd.read_bytes()
    for topic in CAMERAS:
        kept = [picture(topic, row) for row in range(ROWS) if f"{topic} row {row}" not in lost]
        assert blobs(entities, topic) == kept
    for name in lost:  # whatever else is in the file
        assert f"<{name}>".encode() not in written
    for entity in ("/steering/recorded", "/steering/sent", "/pose", "/events", "/camera/center/steering/recorded"):
        columns = {name for name in sound[entity] if name != "rerun.controls.RowId"}
        assert {name: entities[entity][name] for name in columns} == {
            name: sound[entity][name] for name in columns
        }


def test_a_damaged_chunk_of_small_messages_is_one_line_and_an_end(tmp_path: Path) -> None:
    log, rrd = write_drive(tmp_path / "drive.mcap"), tmp_path / "drive.rrd"
    (small, *_) = [chunk for chunk in plain_contents(log).chunks if not is_of_pictures(chunk.messages[0].topic)]
    damage(log, small, "a picture")
    done = run("bc-play", log, "--save", rrd)
    assert done.returncode == 1
    assert f"{log}: damaged: the chunk at byte {small.start:,}" in one_line_of(done)
    assert list(tmp_path.iterdir()) == [log]


def test_of_compared_logs_the_sound_pictures_are_shown(tmp_path: Path) -> None:
    logs = [write_drive(tmp_path / f"{name}.mcap") for name in ("a", "b")]
    lost = damage(logs[1], picture_chunks(logs[1])[2], "a picture")
    done = run("bc-play", *logs, "--save", tmp_path / "x.rrd")
    assert done.returncode == 3
    line, _ = done.stderr.splitlines()
    assert str(logs[1]) in line
    assert str(logs[0]) not in line
    entities = contents(tmp_path / "x.rrd")
    for topic in CAMERAS:
        whole = [picture(topic, row) for row in range(ROWS)]
        assert blobs(entities, f"/a{topic}") == whole
        sound = [blob for row, blob in enumerate(whole) if f"{topic} row {row}" not in lost]
        assert blobs(entities, f"/b{topic}") == sound
