"""The registry of a log's topics, their messages, and how they are drawn; the devices that a person steers with.

A new topic is an entry in `TOPICS`, which writing, checking, editing and playing logs use. A new camera is a name
in `common.car.Camera`.
"""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, get_args

from common.car import CAMERAS, Camera

if TYPE_CHECKING:  # training reads logs where protobuf is not installed; commands begin without NumPy
    import numpy as np
    from google.protobuf.message import Message
    from numpy.typing import NDArray

PROFILE: Final = "bc"
LIBRARY: Final = "behavioural-cloning-toolkit"  # of an MCAP file's header, before the version
SESSION_METADATA: Final = "bc.session"
QUALITY_METADATA: Final = "bc.quality"
REWRITTEN_METADATA: Final = "bc.rewritten"  # the original of a rewritten log
DRIVE_METADATA: Final = "bc.drive"  # a drive's own summary
PERSON_METADATA: Final = "bc.person"  # what a person chose while driving

VEHICLE: Final = "/vehicle"
PILOT_INPUT: Final = "/pilot/input"
PILOT_COMMAND: Final = "/pilot/command"
PREDICTIONS: Final = "/prediction/"  # and the name of a run
EVENTS: Final = "/events"
POSE: Final = "/pose"

ColorName = Literal["blue", "orange", "green", "violet", "grey", "red"]


@dataclass(frozen=True)
class MessageType:
    """A Protobuf message: its full name, and the module of its Python class."""

    name: str
    module: str

    def load(self) -> type[Message]:
        """The Python class, imported when it is first used."""
        loaded: type[Message] = getattr(importlib.import_module(self.module), self.name.rpartition(".")[2])
        return loaded


@dataclass(frozen=True)
class Plot:
    """The axes of one or several lines."""

    path: str  # in the viewer; the lines are under it
    name: str
    unit: str = ""
    range: tuple[float, float] | None = None  # of the vertical axis; None: from the values
    height: float = 1.0  # relative to other plots

    @property
    def title(self) -> str:
        return f"{self.name}, {self.unit}" if self.unit else self.name


@dataclass(frozen=True)
class Line:
    """A number in the messages of a topic, drawn over time."""

    field: str  # of the message; "acceleration.x" is a field of a field
    plot: Plot
    name: str  # under the plot's path
    label: str
    color: ColorName
    is_optional: bool = False  # messages may lack it

    @property
    def path(self) -> str:
        return f"{self.plot.path}/{self.name}"


@dataclass(frozen=True)
class Topic:
    """A topic of a log. Pictures (`COMPRESSED_IMAGE`) are shown in a view named `title`, numbers as `lines`."""

    name: str
    message: MessageType
    title: str = ""
    has_row: bool = True  # a message's sequence number is its row's number
    is_in_order: bool = False  # messages ascend by row; on other topics, they may come late
    camera: Camera | None = None
    lines: tuple[Line, ...] = ()

    @property
    def is_picture(self) -> bool:
        return self.message == COMPRESSED_IMAGE


COMPRESSED_IMAGE: Final = MessageType("foxglove.CompressedImage", "foxglove_schemas_protobuf.CompressedImage_pb2")
LOG_MESSAGE: Final = MessageType("foxglove.Log", "foxglove_schemas_protobuf.Log_pb2")
POSE_IN_FRAME: Final = MessageType("foxglove.PoseInFrame", "foxglove_schemas_protobuf.PoseInFrame_pb2")
VEHICLE_STATE: Final = MessageType("bc.VehicleState", "recorder.bc_pb2")
COMMAND: Final = MessageType("bc.PilotCommand", "recorder.bc_pb2")

STEERING: Final = Plot("/steering", "steering", "-1 left .. 1 right", (-1.0, 1.0), height=2.0)
SPEED: Final = Plot("/speed_mph", "speed", "mph")
PEDALS: Final = Plot("/pedals", "throttle and brake")
LATENCY: Final = Plot("/latency_ms", "latency", "ms")


def camera_topic(camera: Camera) -> str:
    return f"/camera/{camera}"


def prediction_topic(run: str) -> str:
    """The topic with the predictions of a run's network for recorded pictures."""
    return f"{PREDICTIONS}{run}"


def _camera(camera: Camera) -> Topic:
    title = "centre camera" if camera == "center" else f"{camera} camera"
    return Topic(camera_topic(camera), COMPRESSED_IMAGE, title, camera=camera)


TOPICS: Final[Mapping[str, Topic]] = {
    topic.name: topic
    for topic in (
        *map(_camera, CAMERAS),
        Topic(
            VEHICLE,
            VEHICLE_STATE,
            is_in_order=True,
            lines=(
                Line("steering", STEERING, "recorded", "recorded", "blue"),
                Line("speed_mph", SPEED, "driven", "driven", "blue"),
                Line("throttle", PEDALS, "throttle", "throttle", "green"),
                Line("brake", PEDALS, "brake", "brake", "red"),
            ),
        ),
        Topic(PILOT_INPUT, COMPRESSED_IMAGE, "what the network sees"),
        Topic(
            PILOT_COMMAND,
            COMMAND,
            is_in_order=True,
            lines=(
                Line("predicted_steering", STEERING, "predicted", "predicted", "orange"),
                Line("steering", STEERING, "sent", "sent", "green"),
                Line("expert_steering", STEERING, "expert", "expert", "violet", is_optional=True),
                Line("set_speed_mph", SPEED, "set", "set", "grey"),
                Line("predicted_speed_mph", SPEED, "predicted", "predicted", "orange", is_optional=True),
                Line("throttle", PEDALS, "sent", "throttle sent", "orange"),
                Line("predicted_throttle", PEDALS, "predicted", "predicted", "violet", is_optional=True),
                Line("total_ms", LATENCY, "total", "telemetry to answer", "violet"),
                Line("network_ms", LATENCY, "network", "network", "orange"),
                Line("decode_ms", LATENCY, "decode", "JPEG and crop", "blue"),
                Line("parse_ms", LATENCY, "parse", "reading the message", "grey"),
            ),
        ),
        Topic(POSE, POSE_IN_FRAME),
        Topic(EVENTS, LOG_MESSAGE, "events", has_row=False),
    )
}
"""Every written topic, by name. In addition, a log of predictions has a topic for each run."""

VEHICLE_COLUMNS: Final = ("steering", "throttle", "brake", "speed_mph")
PLOTS: Final = tuple(dict.fromkeys(line.plot for topic in TOPICS.values() for line in topic.lines))
CAMERA_TOPICS: Final = frozenset(name for name, topic in TOPICS.items() if topic.camera is not None)
PICTURE_TOPICS: Final = frozenset(name for name, topic in TOPICS.items() if topic.is_picture)
ROW_TOPICS: Final = frozenset(name for name, topic in TOPICS.items() if topic.has_row)


Device = Literal["keyboard", "mouse", "gamepad", "touch"]
RowDevice = Device | Literal[""]
DEVICES: Final[tuple[RowDevice, ...]] = ("", *get_args(Device))
"""In the order of VehicleState.Device; empty if nobody steered by hand, or the device is unknown."""


def device_value(device: Device | None) -> str | None:
    """The device as the value of `VehicleState.device`."""
    return device.upper() if device else None


def most_used(rows: Mapping[int, int]) -> RowDevice:
    """The device of most rows, from the number of rows by device number; empty if no device is known."""
    by_hand = {number: count for number, count in rows.items() if 0 < number < len(DEVICES) and count}
    return DEVICES[max(by_hand, key=lambda number: by_hand[number])] if by_hand else ""


def most_used_of(numbers: NDArray[np.int8]) -> RowDevice:
    """The device of most rows, from the device number of each row (N,); empty if no device is known."""
    return most_used(dict(sorted(Counter(numbers.tolist()).items())))
