"""Messages of a log as they come, turned into the entities and curves that playback makes of a whole log."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import rerun as rr
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Log_pb2 import Log as LogMessage
from google.protobuf.message import Message as ProtobufMessage
from numpy.typing import NDArray

from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.topics import CAMERAS, EVENTS, PILOT_COMMAND, PILOT_INPUT, VEHICLE, camera_topic
from viz.layout import log_layout
from viz.playback import curve_values, log_style, send_curve, time_column

PICTURE_TOPICS: Final = (*map(camera_topic, CAMERAS), PILOT_INPUT)
KINDS: Final[dict[str, type[ProtobufMessage]]] = {
    **dict.fromkeys(PICTURE_TOPICS, CompressedImage),
    VEHICLE: VehicleState,
    PILOT_COMMAND: PilotCommand,
    EVENTS: LogMessage,
}
"""What is shown, and what it must be."""

# As Rerun's MCAP reader calls them.
_LEVELS: Final = {
    LogMessage.Level.DEBUG: "DEBUG",
    LogMessage.Level.INFO: "INFO",
    LogMessage.Level.WARNING: "WARN",
    LogMessage.Level.ERROR: "ERROR",
    LogMessage.Level.FATAL: "CRITICAL",
}


@dataclass(frozen=True)
class Shown:
    """A message to show; `content` is of the kind that KINDS tells for its topic."""

    topic: str
    log_time_ns: int
    content: Any


class MessageSender:
    """Sends messages to a recording, and a layout whenever there is something new to lay out."""

    def __init__(self, recording: rr.RecordingStream) -> None:
        self._recording = recording
        self._topics: set[str] = set()

    def send(self, messages: Iterable[Shown]) -> None:
        by_topic: dict[str, list[Shown]] = {}
        for message in messages:
            by_topic.setdefault(message.topic, []).append(message)
        self._prepare(by_topic.keys())
        for topic, found in by_topic.items():
            time_ns = np.array([message.log_time_ns for message in found], np.int64)
            contents = [message.content for message in found]
            if KINDS[topic] is CompressedImage:
                self._send_pictures(topic, time_ns, contents)
            elif KINDS[topic] is LogMessage:
                self._send_events(topic, time_ns, contents)
            else:
                for curve, values in curve_values(topic, contents):
                    send_curve(self._recording, curve, time_ns, values)

    def _prepare(self, topics: Iterable[str]) -> None:
        new = set(topics) - self._topics
        for curve, _ in (each for topic in new for each in curve_values(topic, [])):
            log_style(self._recording, curve)
        if new.intersection(PICTURE_TOPICS) or (new and not self._topics):
            # The first event may come late, and must not change a layout that somebody has arranged meanwhile.
            self._recording.send_blueprint(log_layout({*self._topics, *new, EVENTS}))
        self._topics |= new

    def _send_pictures(self, topic: str, time_ns: NDArray[np.int64], pictures: list[CompressedImage]) -> None:
        columns = rr.EncodedImage.columns(
            blob=[picture.data for picture in pictures],
            media_type=[f"image/{picture.format or 'jpeg'}" for picture in pictures],
        )
        self._recording.send_columns(topic, [time_column(time_ns)], columns)

    def _send_events(self, topic: str, time_ns: NDArray[np.int64], events: list[LogMessage]) -> None:
        columns = rr.TextLog.columns(
            text=[event.message for event in events],
            level=[_LEVELS.get(event.level, "INFO") for event in events],
        )
        self._recording.send_columns(topic, [time_column(time_ns)], columns)
