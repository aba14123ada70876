"""Writing a log: an MCAP file that appears under its name only when it is whole."""

from __future__ import annotations

import os
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Log_pb2 import Log as LogMessage
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.well_known import MessageEncoding
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_protobuf.schema import register_schema

from common import files
from recorder import topics
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.topics import Camera, camera_topic

CHUNK_BYTES = 256 * 1024
FLUSH_S = 1.0

EventLevel = Literal["INFO", "WARNING", "ERROR"]


def timestamp(time_ns: int) -> Timestamp:
    return Timestamp(seconds=time_ns // 1_000_000_000, nanos=time_ns % 1_000_000_000)


def toolkit_version() -> str:
    try:
        return version("behavioural-cloning-toolkit")
    except PackageNotFoundError:  # run from a source tree that was never installed
        return "unknown"


class LogWriter:
    """One log being written, as `NAME.mcap.XXXXXX.part` until `close()` gives it its name.

    Chunks are uncompressed, so that every picture lies in the file byte for byte and can be read by its
    offset. All messages of one frame share a log time and a sequence number (the frame's number in the log).
    Messages of one topic are kept in the order in which they are written, whatever their times.

    ``live=True`` closes a chunk at least once a second, so that a killed process loses at most that; an
    import leaves it off, and its bytes then depend on its input alone.

    As a context manager it closes the log, or discards it if anything was raised; what was recorded live is
    kept even then, because nobody can record it again.
    """

    def __init__(
        self, path: Path, metadata: dict[str, str], *, overwrite: bool = False, live: bool = False
    ) -> None:
        """Raises UserError if `path` exists and may not be overwritten."""
        files.refuse_existing(path, overwrite)
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path = path
        self.part = files.part_path(path)
        self._overwrite = overwrite
        self._live = live
        self._last_flush_s = time.monotonic()
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._stream = self.part.open("xb")
        self._mcap = McapWriter(self._stream, chunk_size=CHUNK_BYTES, compression=CompressionType.NONE)
        self._mcap.start(profile=topics.PROFILE, library=f"behavioural-cloning-toolkit {toolkit_version()}")
        self._mcap.add_metadata(topics.SESSION_METADATA, {**metadata, "toolkit": toolkit_version()})

    def picture(self, camera: Camera, time_ns: int, sequence: int, jpeg: bytes) -> None:
        """A camera's JPEG, byte for byte."""
        self._image(camera_topic(camera), time_ns, sequence, jpeg, "jpeg")

    def crop(self, time_ns: int, sequence: int, png: bytes) -> None:
        """The picture that the network saw, as PNG (lossless)."""
        self._image(topics.PILOT_INPUT, time_ns, sequence, png, "png")

    def vehicle(self, time_ns: int, sequence: int, state: VehicleState) -> None:
        self._write(topics.VEHICLE, state, time_ns, sequence)

    def command(self, time_ns: int, sequence: int, command: PilotCommand) -> None:
        self._write(topics.PILOT_COMMAND, command, time_ns, sequence)

    def pose(self, time_ns: int, sequence: int, pose: PoseInFrame) -> None:
        self._write(topics.POSE, pose, time_ns, sequence)

    def event(self, time_ns: int, text: str, level: EventLevel = "INFO", name: str = "") -> None:
        """Something that happened: `name` says where (`recorder`, `drive`), `text` what."""
        message = LogMessage(
            timestamp=timestamp(time_ns), level=LogMessage.Level.Value(level), message=text, name=name
        )
        self._write(topics.EVENTS, message, time_ns, 0)

    def flush_if_due(self) -> None:
        """Close the chunk if the last flush is over a second ago (call it also while nothing arrives)."""
        now_s = time.monotonic()
        if self._live and now_s - self._last_flush_s >= FLUSH_S:
            self._mcap.flush()
            self._last_flush_s = now_s

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        self._mcap.add_metadata(name, values)

    def close(self) -> None:
        """Write the summary and give the log its name. Raises UserError if the name was taken meanwhile."""
        self._mcap.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()
        files.publish(self.part, self.path, self._overwrite)

    def discard(self) -> None:
        """Give up: nothing of this log stays."""
        self._stream.close()
        self.part.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None or (self._live and self._channels):
            self.close()
        else:
            self.discard()

    def _image(self, topic: str, time_ns: int, sequence: int, data: bytes, kind: str) -> None:
        # Rerun gives every entity a frame of this name; with none, or another, its views warn of a missing one.
        frame_id = f"tf#{topic}"
        image = CompressedImage(timestamp=timestamp(time_ns), frame_id=frame_id, data=data, format=kind)
        self._write(topic, image, time_ns, sequence)

    def _write(self, topic: str, message: Message, time_ns: int, sequence: int) -> None:
        channel = self._channels.get(topic) or self._register(topic, type(message))
        self._mcap.add_message(
            channel,
            log_time=time_ns,
            publish_time=time_ns,
            sequence=sequence,
            data=message.SerializeToString(),
        )
        if self._live:
            self.flush_if_due()

    def _register(self, topic: str, message: type[Message]) -> int:
        name = message.DESCRIPTOR.full_name
        if name not in self._schemas:
            self._schemas[name] = register_schema(self._mcap, message)
        self._channels[topic] = self._mcap.register_channel(topic, MessageEncoding.Protobuf, self._schemas[name])
        return self._channels[topic]
