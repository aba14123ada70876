"""Other programs' logs, written by those programs' own libraries: MCAP files and ROS 2 bags."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.message import Message
from mcap_protobuf.schema import register_schema
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.helpers.imports import topics
from tests.helpers.plain_mcap import plain_writer
from tests.helpers.udacity import jpeg

S = 1_000_000_000
START_NS = 1_720_880_000 * S
CAMERA, VIDEO, WHEEL = "/camera/compressed", "/camera/video", "/wheel"
_JSON_TYPES = {CAMERA: "foxglove.CompressedImage", VIDEO: "foxglove.CompressedVideo"}
TOPICS = topics(CAMERA, f"{WHEEL}.steering.angle")

Told = tuple[str, float, object]  # topic, seconds from the start, message
Row = tuple[float, float, bytes]  # seconds from the start, steering, picture


def angle(value: object) -> dict[str, object]:
    return {"steering": {"angle": value}, "buttons": [0, 1], "mode": "manual"}


def image(picture: bytes) -> CompressedImage:
    return CompressedImage(frame_id="camera", data=picture, format="jpeg")


def write_mcap(path: Path, reported: Iterable[Told], **options: Any) -> Path:
    """A file as another program would write it: protobuf messages, and dictionaries or bytes as JSON."""
    with plain_writer(path, profile="other", library="other 1.0", **options) as writer:
        channels: dict[str, int] = {}
        for topic, time_s, content in reported:
            if topic not in channels:
                if isinstance(content, Message):
                    schema, encoding = register_schema(writer, type(content)), "protobuf"
                else:
                    name = _JSON_TYPES.get(topic, "car.Wheel")
                    schema, encoding = writer.register_schema(name, "jsonschema", b'{"type": "object"}'), "json"
                channels[topic] = writer.register_channel(topic, encoding, schema)
            data = (
                content.SerializeToString()
                if isinstance(content, Message)
                else content
                if isinstance(content, bytes)
                else json.dumps(content).encode()
            )
            time_ns = START_NS + round(time_s * S)
            writer.add_message(channels[topic], time_ns, data, time_ns)
    return path


PICTURES = [jpeg(60, 1), jpeg(90, 2), jpeg(120, 3)]
DRIVE: list[Told] = [
    (WHEEL, 0.0, angle(0.25)),
    (CAMERA, 0.05, image(PICTURES[0])),
    (WHEEL, 0.10, angle(-0.5)),
    ("/lidar", 0.11, {"points": [1.0] * 100}),
    (CAMERA, 0.15, image(PICTURES[1])),
    (CAMERA, 0.25, image(PICTURES[2])),
]
ROWS: list[Row] = [(0.05, 0.25, PICTURES[0]), (0.15, -0.5, PICTURES[1]), (0.25, -0.5, PICTURES[2])]

# ROS 2

DRIVE_TYPE = "ackermann_msgs/msg/AckermannDriveStamped"
STORE = get_typestore(Stores.ROS2_HUMBLE)
ACKERMANN = "\n".join(
    f"float32 {name}" for name in ("steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk")
)
STORE.register(get_types_from_msg(ACKERMANN, "ackermann_msgs/msg/AckermannDrive"))
STORE.register(get_types_from_msg("std_msgs/Header header\nackermann_msgs/AckermannDrive drive", DRIVE_TYPE))
IMAGE_TYPE, TWIST_TYPE, JOY_TYPE = (
    "sensor_msgs/msg/CompressedImage",
    "geometry_msgs/msg/Twist",
    "sensor_msgs/msg/Joy",
)
ROS_TOPICS = topics(CAMERA, "/cmd_vel.angular.z", steering_scale=-1.0)
Kind = Callable[[float], tuple[str, str, object]]  # steering -> topic, type, message


def header() -> Any:
    return STORE.types["std_msgs/msg/Header"](STORE.types["builtin_interfaces/msg/Time"](1, 2), "car")


def twist(value: float) -> tuple[str, str, object]:
    vector = STORE.types["geometry_msgs/msg/Vector3"]
    return "/cmd_vel", TWIST_TYPE, STORE.types[TWIST_TYPE](vector(1.0, 0.0, 0.0), vector(0.0, 0.0, value))


def joystick(value: float) -> tuple[str, str, object]:
    axes, buttons = np.array([value, 0.5], np.float32), np.zeros(2, np.int32)
    return "/joy", JOY_TYPE, STORE.types[JOY_TYPE](header(), axes, buttons)


def ackermann(value: float) -> tuple[str, str, object]:
    drive = STORE.types["ackermann_msgs/msg/AckermannDrive"](value, 0.0, 1.5, 0.0, 0.0)
    return "/drive", DRIVE_TYPE, STORE.types[DRIVE_TYPE](header(), drive)


def write_bag(folder: Path, storage: StoragePlugin, kind: Kind = twist, rows: Sequence[Row] = ROWS) -> Path:
    """A bag with a command and a picture for each row; the sign is ROS's, left positive."""
    with BagWriter(folder, version=9, storage_plugin=storage) as writer:
        connections: dict[str, Any] = {}
        for time_s, steering, picture in rows:
            compressed = STORE.types[IMAGE_TYPE](header(), "jpeg", np.frombuffer(picture, np.uint8))
            for topic, msgtype, message in (kind(-steering), (CAMERA, IMAGE_TYPE, compressed)):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, msgtype, typestore=STORE)
                data = STORE.serialize_cdr(message, msgtype)
                writer.write(connections[topic], START_NS + round(time_s * S), data)
    return folder
