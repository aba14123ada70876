"""Other programs' logs become ours: MCAP files and ROS 2 bags, written here by those programs' own libraries."""

from __future__ import annotations

import base64
import json
import math
import random
import sqlite3
import struct
import sys
import zlib
from pathlib import Path
from typing import Any

import cv2
import foxglove
import numpy as np
import pytest
from foxglove.channels import CompressedImageChannel
from foxglove.messages import CompressedImage as SdkImage
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.writer import CompressionType
from mcap_protobuf.schema import register_schema
from rosbags.rosbag2 import StoragePlugin

from common import UserError
from recorder import Imported, Log, LogError, RecordingError
from recorder.sources.find_recording import kind_of
from recorder.sources.import_recording import import_recording
from recorder.sources.settings import ImportSettings
from tests.helpers.imports import topics
from tests.helpers.logs import flip_bit, read_messages
from tests.helpers.other_logs import (
    CAMERA,
    DRIVE,
    PICTURES,
    ROS_TOPICS,
    ROWS,
    START_NS,
    TOPICS,
    WHEEL,
    Kind,
    Row,
    S,
    ackermann,
    angle,
    image,
    joystick,
    twist,
    write_bag,
    write_mcap,
)
from tests.helpers.plain_mcap import plain_writer


def png(level: int) -> bytes:
    ok, encoded = cv2.imencode(".png", np.full((160, 320, 3), level, np.uint8))
    assert ok
    return encoded.tobytes()


def rows_of(log: Path) -> list[Row]:
    """The rows as mcap's own reader sees them; every picture has one, and they share time and number."""
    messages = read_messages(log)
    rows = []
    for (seen, picture), (driven, state) in zip(messages["/camera/center"], messages["/vehicle"], strict=True):
        assert (seen.log_time, seen.sequence) == (driven.log_time, driven.sequence)
        assert (state.throttle, state.brake, math.isnan(state.speed_mph)) == (0, 0, True)
        rows.append(((seen.log_time - START_NS) / S, state.steering, picture.data))
    return rows


def imported(source: Path, topics: ImportSettings = TOPICS) -> Imported:
    return import_recording(source, source.parent / "imported" / "log.mcap", topics)


def error_of(source: Path, topics: ImportSettings = TOPICS) -> str:
    """The one line of the error; nothing is written."""
    with pytest.raises(RecordingError) as error:
        imported(source, topics)
    assert not list((source.parent / "imported").glob("*"))
    text = str(error.value)
    assert str(source) in text
    assert "\n" not in text
    return text


@pytest.mark.parametrize(
    "options",
    [
        {"compression": CompressionType.ZSTD},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.NONE},
        {"compression": CompressionType.ZSTD, "chunk_size": 1},
        {"use_chunking": False},
    ],
    ids=["zstd", "lz4", "uncompressed", "a chunk each", "no chunks"],
)
def test_every_picture_gets_the_last_steering_before_it(tmp_path: Path, options: dict[str, Any]) -> None:
    done = imported(write_mcap(tmp_path / "other.mcap", DRIVE, **options))
    assert rows_of(done.path) == ROWS
    assert (done.rows, done.pictures, list(done.skipped)) == (3, 3, [])


def test_the_log_reports_where_it_comes_from(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "other.mcap", DRIVE)
    columns = topics(CAMERA, f"{WHEEL}.steering.angle", steering_scale=-0.5)
    with Log(imported(source, columns).path) as log:
        expected = {
            "source": "mcap",
            "recording": "other.mcap",
            "image_topic": CAMERA,
            "steering_topic": f"{WHEEL}.steering.angle",
            "steering_scale": "-0.5",
        }
        assert log.metadata.items() >= expected.items()
        assert log.read_metadata("bc.quality")["out_of_range"] == "0"


def test_pictures_in_json_are_base64(tmp_path: Path) -> None:
    reported = [
        (topic, time_s, {"format": "jpeg", "data": base64.b64encode(content.data).decode()})
        if isinstance(content, CompressedImage)
        else (topic, time_s, content)
        for topic, time_s, content in DRIVE
    ]
    assert rows_of(imported(write_mcap(tmp_path / "other.mcap", reported)).path) == ROWS


def test_what_the_foxglove_sdk_writes(tmp_path: Path) -> None:
    source, context = tmp_path / "sdk.mcap", foxglove.Context()
    with foxglove.open_mcap(source, context=context):
        camera = CompressedImageChannel(CAMERA, context=context)
        wheel = foxglove.Channel(WHEEL, message_encoding="json", context=context)
        for time_s, value, picture in ROWS:
            wheel.log(angle(value), log_time=START_NS + round(time_s * S))
            camera.log(SdkImage(data=picture, format="jpeg"), log_time=START_NS + round(time_s * S))
    done = imported(source)
    assert rows_of(done.path) == ROWS
    assert list(done.skipped) == []


def test_a_field_of_a_protobuf_message_may_be_nested_and_in_a_list(tmp_path: Path) -> None:
    poses = PosesInFrame()
    poses.poses.add().position.y = 0.125
    poses.poses.add().position.y = 0.5
    source = write_mcap(tmp_path / "other.mcap", [(WHEEL, 0.0, poses), (CAMERA, 0.1, image(PICTURES[0]))])
    done = imported(source, topics(CAMERA, f"{WHEEL}.poses.1.position.y"))
    assert rows_of(done.path) == [(0.1, 0.5, PICTURES[0])]


def test_steering_may_lie_anywhere_in_the_file(tmp_path: Path) -> None:
    pictures, steering = [DRIVE[1], DRIVE[4], DRIVE[5]], [DRIVE[2], DRIVE[0]]
    source = write_mcap(tmp_path / "other.mcap", [*pictures, *steering], chunk_size=1)
    assert rows_of(imported(source).path) == ROWS


def test_pictures_without_a_steering_in_time_are_left_out_and_named(tmp_path: Path) -> None:
    reported = [
        (CAMERA, 0.0, image(PICTURES[0])),
        (WHEEL, 0.5, angle(0.5)),
        (CAMERA, 0.5, image(PICTURES[0])),
        (CAMERA, 1.5, image(PICTURES[1])),
        (CAMERA, 1.501, image(PICTURES[2])),
    ]
    done = imported(write_mcap(tmp_path / "other.mcap", reported))
    assert rows_of(done.path) == [(0.5, 0.5, PICTURES[0]), (1.5, 0.5, PICTURES[1])]
    assert list(done.skipped) == [
        ("pictures before the first steering", f"{CAMERA} at 1720880000.000 s"),
        (
            "pictures whose last steering is over 1 s old (--max-steering-age SECONDS allows more)",
            f"{CAMERA} at 1720880001.501 s",
        ),
    ]
    events = [event.message for _, event in read_messages(done.path)["/events"]]
    assert len(events) == 2


def test_the_scale_turns_left_into_minus(tmp_path: Path) -> None:
    done = imported(write_mcap(tmp_path / "other.mcap", DRIVE), topics(CAMERA, TOPICS.steering, -2.0))
    assert [steering for _, steering, _ in rows_of(done.path)] == [-0.5, 1.0, 1.0]
    assert len(done.skipped) == 0


def test_values_out_of_range_are_kept_and_named(tmp_path: Path) -> None:
    done = imported(write_mcap(tmp_path / "other.mcap", DRIVE), topics(CAMERA, TOPICS.steering, 8.0))
    assert [steering for _, steering, _ in rows_of(done.path)] == [2.0, -4.0, -4.0]
    assert len(done.skipped) == 3
    assert all("steering beyond -1..1" in reason for reason in done.skipped.counts)


def test_png_pictures_stay_png(tmp_path: Path) -> None:
    reported = [(WHEEL, 0.0, angle(0.0)), (CAMERA, 0.1, image(png(40))), (CAMERA, 0.2, image(PICTURES[0]))]
    done = imported(write_mcap(tmp_path / "other.mcap", reported))
    pictures = [(picture.data, picture.format) for _, picture in read_messages(done.path)["/camera/center"]]
    assert pictures == [(png(40), "png"), (PICTURES[0], "jpeg")]


def test_what_is_no_whole_picture_is_left_out_and_named(tmp_path: Path) -> None:
    broken = [b"", b"GIF89a", PICTURES[0][:-300], png(40)[:-20], png(40)[:20], b"\x89PNG\r\n\x1a\n" + bytes(99)]
    reported = [(WHEEL, 0.0, angle(0.0)), *((CAMERA, 0.1 + i / 100, image(data)) for i, data in enumerate(broken))]
    done = imported(write_mcap(tmp_path / "other.mcap", [*reported, (CAMERA, 0.9, image(PICTURES[0]))]))
    assert rows_of(done.path) == [(0.9, 0.0, PICTURES[0])]
    assert done.skipped.counts == {"pictures that are not whole JPEG or PNG files": len(broken)}


def test_a_small_png_that_unpacks_to_a_huge_one_is_not_unpacked(tmp_path: Path) -> None:
    side = 8200
    chunks = [
        (b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)),
        (b"IDAT", zlib.compress(bytes(side * (side + 1)), 1)),
    ]
    bomb = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in [*chunks, (b"IEND", b"")]
    )
    source = write_mcap(tmp_path / "other.mcap", [(WHEEL, 0.0, angle(0.0)), (CAMERA, 0.1, image(bomb))])
    assert "; pictures that are not whole JPEG or PNG files: 1 (" in error_of(source)


def test_messages_that_make_no_sense_are_left_out_and_named(tmp_path: Path) -> None:
    reported = [
        *DRIVE,
        (WHEEL, 0.20, b"{"),
        (WHEEL, 0.21, b"[" * 100_000),
        (WHEEL, 0.22, angle(math.nan)),
        (WHEEL, 0.23, angle(None)),
        (WHEEL, 0.24, angle(True)),
        (WHEEL, 0.25, b'{"steering": {"angle": 1' + b"0" * 400 + b"}}"),
        (WHEEL, 0.25, {}),
    ]
    done = imported(write_mcap(tmp_path / "other.mcap", reported))
    assert rows_of(done.path) == ROWS
    assert done.skipped.counts == {"messages that cannot be decoded": 2, "messages without a steering": 5}


def test_an_unfinished_file_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "other.mcap", DRIVE, compression=CompressionType.NONE, chunk_size=1)
    data = source.read_bytes()
    source.write_bytes(data[: data.index(PICTURES[2]) + 100])
    done = imported(source)
    assert rows_of(done.path) == ROWS[:2]
    assert ["unfinished" in name for _, name in done.skipped] == [True]


def test_a_damaged_chunk_is_an_error_that_reports_what_to_do(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "other.mcap", DRIVE, compression=CompressionType.NONE)
    flip_bit(source, source.read_bytes().index(PICTURES[1]) + 500)
    with pytest.raises(LogError, match="bc-log recover"):
        imported(source)


# What the user may have got wrong


def test_an_unknown_topic_lists_those_that_there_are(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "other.mcap", DRIVE)
    for printed in (topics("/cam", TOPICS.steering), topics(CAMERA, "/wheels.steering.angle")):
        reported = error_of(source, printed)
        assert f"{CAMERA} (foxglove.CompressedImage), /lidar (car.Wheel), {WHEEL} (car.Wheel)" in reported


@pytest.mark.parametrize(
    ("field", "reported"),
    [
        ("steer", "has no steer; it has steering, buttons, mode"),
        ("steering.angel", "steering has no angel; it has angle"),
        ("steering", "steering is not a number but a message; it has angle"),
        ("mode", "mode is not a number but a text"),
        ("buttons.2", "buttons has no 2; it has 0, 1"),
        ("buttons", "buttons is not a number but a list; it has 0, 1"),
        ("", "is not a number but a message; it has steering, buttons, mode"),
    ],
)
def test_an_unknown_field_lists_those_that_there_are(tmp_path: Path, field: str, reported: str) -> None:
    source = write_mcap(tmp_path / "other.mcap", DRIVE)
    assert reported in error_of(source, topics(CAMERA, f"{WHEEL}.{field}".removesuffix(".")))


def test_pictures_that_are_not_compressed_are_named_by_their_type(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "other.mcap", [(WHEEL, 0.0, angle(0.0)), (CAMERA, 0.1, RawImage(width=320))])
    reported = error_of(source)
    assert "foxglove.RawImage" in reported
    assert "foxglove.CompressedImage, foxglove.CompressedVideo or sensor_msgs/CompressedImage" in reported


def test_without_any_steering_the_error_reports_why(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "other.mcap", [(WHEEL, 0.0, b"?"), (WHEEL, 0.1, b"?"), DRIVE[1]])
    assert "messages that cannot be decoded: 2 (" in error_of(source)


def test_an_unknown_encoding_or_definition_is_named(tmp_path: Path) -> None:
    for encoding, schema, reported in (("ros1", b"float64 x", "ros1"), ("protobuf", b"\xff", "definition")):
        source = tmp_path / f"{encoding}.mcap"
        with plain_writer(source) as writer:
            number = writer.register_schema("car.Wheel", encoding, schema)
            writer.add_message(writer.register_channel(WHEEL, encoding, number), 0, b"?", 0)
            writer.add_message(
                writer.register_channel(CAMERA, "protobuf", register_schema(writer, CompressedImage)), 0, b"", 0
            )
        assert reported in error_of(source)


# ROS 2

STORAGES = pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3], ids=["mcap", "sqlite3"])


@STORAGES
@pytest.mark.parametrize(
    ("kind", "field"),
    [(twist, "/cmd_vel.angular.z"), (joystick, "/joy.axes.0"), (ackermann, "/drive.drive.steering_angle")],
    ids=["Twist", "Joy", "AckermannDriveStamped"],
)
def test_a_ros2_bag(tmp_path: Path, storage: StoragePlugin, kind: Kind, field: str) -> None:
    done = imported(write_bag(tmp_path / "bag", storage, kind), topics(CAMERA, field, -1.0))
    assert rows_of(done.path) == ROWS
    assert list(done.skipped) == []
    with Log(done.path) as log:
        assert (log.metadata["source"], log.metadata["recording"]) == ("ros2 bag", "bag")


@pytest.mark.parametrize("kind", [twist, ackermann])
def test_an_older_bag_that_holds_no_definitions(tmp_path: Path, kind: Kind) -> None:
    bag = write_bag(tmp_path / "bag", StoragePlugin.SQLITE3, kind)
    database = sqlite3.connect(bag / "bag.db3")
    database.executescript("DROP TABLE message_definitions; DROP TABLE schema; DROP TABLE metadata;")
    database.close()
    field = "/cmd_vel.angular.z" if kind is twist else "/drive.drive.steering_angle"
    assert rows_of(imported(bag, topics(CAMERA, field, -1.0)).path) == ROWS


def test_a_time_that_no_log_can_hold_is_left_out(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", StoragePlugin.SQLITE3)
    database = sqlite3.connect(bag / "bag.db3")
    database.execute("UPDATE messages SET timestamp = -1 WHERE id = 6")
    database.execute("UPDATE messages SET timestamp = 'soon' WHERE id = 4")
    database.commit()
    database.close()
    done = imported(bag, ROS_TOPICS)
    assert rows_of(done.path) == ROWS[:1]
    assert done.skipped.counts == {"messages with a time that no log can hold": 2}


@STORAGES
def test_a_bag_of_several_files_is_read_in_the_order_that_it_shows(tmp_path: Path, storage: StoragePlugin) -> None:
    bag, suffix = tmp_path / "bag", ".mcap" if storage is StoragePlugin.MCAP else ".db3"
    write_bag(bag, storage, rows=ROWS[:2])
    (bag / f"bag{suffix}").rename(bag / f"z{suffix}")
    write_bag(tmp_path / "second", storage, rows=ROWS[2:])
    (tmp_path / "second" / f"second{suffix}").rename(bag / f"a{suffix}")
    (tmp_path / "second" / "metadata.yaml").unlink()
    (bag / f"forgotten{suffix}").write_bytes((bag / f"a{suffix}").read_bytes())
    names = [f"bag/z{suffix}", f"a{suffix}", f"a{suffix}", f"gone{suffix}"]
    (bag / "metadata.yaml").write_text(
        json.dumps({"rosbag2_bagfile_information": {"relative_file_paths": names}})  # JSON is YAML
    )
    done = imported(bag, ROS_TOPICS)
    assert rows_of(done.path) == ROWS
    assert [name for _, name in done.skipped] == [f"gone{suffix}", f"forgotten{suffix}"]


def test_a_journal_that_is_not_merged_is_named(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", StoragePlugin.SQLITE3)
    (bag / "bag.db3-wal").write_bytes(b"messages")
    done = imported(bag, ROS_TOPICS)
    assert rows_of(done.path) == ROWS
    assert [name for _, name in done.skipped] == ["bag.db3-wal"]


def test_a_compressed_bag_is_refused_and_reported_how_to_unpack(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", StoragePlugin.SQLITE3)
    text = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(text.replace("compression_mode: ''", "compression_mode: FILE"))
    assert "ros2 bag convert" in error_of(bag, ROS_TOPICS)


@STORAGES
def test_nothing_outside_of_the_bag_is_read(tmp_path: Path, storage: StoragePlugin) -> None:
    bag, private = tmp_path / "bag", write_bag(tmp_path / "private", storage)
    (secret,) = (path for path in private.iterdir() if path.name != "metadata.yaml")
    bag.mkdir()
    (bag / f"link{secret.suffix}").symlink_to(secret)
    names = [f"../private/{secret.name}", str(secret), f"link{secret.suffix}"]
    text = json.dumps({"rosbag2_bagfile_information": {"relative_file_paths": names}})
    (bag / "metadata.yaml").write_text(text)
    assert "all files that" in error_of(bag, ROS_TOPICS)


@pytest.mark.parametrize("package", ["mcap_ros2.decoder", "ruamel.yaml"])
def test_what_is_not_installed_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str) -> None:
    bag = write_bag(tmp_path / "bag", StoragePlugin.MCAP)
    monkeypatch.setitem(sys.modules, package, None)  # Python's own way to say: cannot be imported
    with pytest.raises(RecordingError, match=r"pip install .*\[ros\]"):
        imported(bag, ROS_TOPICS)


def test_what_looks_like_another_programs_log(tmp_path: Path) -> None:
    assert kind_of(write_bag(tmp_path / "mcap", StoragePlugin.MCAP)) == "log"
    assert kind_of(write_bag(tmp_path / "sqlite", StoragePlugin.SQLITE3)) == "log"
    assert kind_of(tmp_path / "drive.mcap") == "log"
    assert kind_of(tmp_path / "drive.mcap.1a2b3c.part") == "log"
    assert kind_of(tmp_path) != "log"
    assert kind_of(tmp_path / "nowhere") != "log"
    (tmp_path / "metadata.yaml").write_text("")
    assert kind_of(tmp_path) != "log"


@pytest.mark.parametrize("name", ["bag.mcap", "bag.db3", "metadata.yaml"])
def test_a_damaged_bag_is_never_worse_than_a_clear_error(tmp_path: Path, name: str) -> None:
    storage = StoragePlugin.MCAP if name.endswith("mcap") else StoragePlugin.SQLITE3
    bag = write_bag(tmp_path / "bag", storage, ackermann)
    data, generator = (bag / name).read_bytes(), random.Random(7)
    errors = []
    for number in range(60):
        damaged = bytearray(data)
        if number % 3:
            for _ in range(generator.choice((1, 10, 200))):
                damaged[generator.randrange(len(damaged))] = generator.randrange(256)
        else:
            damaged = damaged[: generator.randrange(len(damaged))]
        (bag / name).write_bytes(damaged)
        try:
            columns = topics(CAMERA, "/drive.drive.steering_angle")
            import_recording(bag, tmp_path / "log.mcap", columns, overwrite=True)
        except UserError as error:
            errors.append(str(error))
    assert len(errors) > 5
    assert not any("\n" in error for error in errors)
