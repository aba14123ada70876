"""Writes a log: an MCAP file that gets its name only when it is complete."""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import os
import time
from collections.abc import Callable, Container, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, Final, Literal, Self

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Log_pb2 import Log as LogMessage
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import DecodeError, Message
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.records import Attachment, Channel, Schema
from mcap.records import Message as McapMessage
from mcap.well_known import MessageEncoding
from mcap_protobuf.schema import register_schema

from common import UserError, files
from common.car import Camera
from common.interrupts import uninterrupted
from common.locks import lock
from common.versions import version_of
from recorder import topics
from recorder.bc_pb2 import PilotCommand, Prediction, VehicleState
from recorder.errors import LogError, recovery
from recorder.log.findings import WrittenRows
from recorder.log.meant_gaps import MeantGap
from recorder.log.reader import Log
from recorder.log.tags import Tag, add_tags
from recorder.mcap.compressed_image import image_data, is_image_channel
from recorder.mcap.split_chunks import CopiedChannels, SplitChunks
from recorder.pictures.picture_size import PNG_START, PictureSizes, width_and_height
from simulator.pose import Pose

FLUSH_S: Final = 0.5  # half of what a crash may cost: a flush may be late, and the disk takes time

EventLevel = Literal["INFO", "WARNING", "ERROR"]
AddMessage = Callable[[int, bytes, int, int], object]
"""Adds a message to a channel: log time, content, publish time, sequence number."""


def log_beside(log: Path, taken: Container[Path]) -> Path:
    """A free path for another simulator's log, not among the `taken` ones: run-2.mcap for run.mcap."""
    names = (log.with_stem(f"{log.stem}-{number}") for number in itertools.count(2))
    return next(name for name in names if name not in taken and not os.path.lexists(name))


def timestamp(time_ns: int) -> Timestamp:
    return Timestamp(seconds=time_ns // 1_000_000_000, nanos=time_ns % 1_000_000_000)


def pose_message(pose: Pose, time_ns: int) -> PoseInFrame:
    """A car's pose as a Foxglove message: metres, x east, y north, z up; attitude a quaternion."""
    message = PoseInFrame(timestamp=timestamp(time_ns), frame_id="world")
    message.pose.position.x, message.pose.position.y, message.pose.position.z = pose.x_m, pose.y_m, pose.z_m
    # nose up is a negative rotation around the y axis, which points to the left
    (cy, sy), (cp, sp), (cr, sr) = (
        (math.cos(angle / 2), math.sin(angle / 2)) for angle in (pose.heading_rad, -pose.pitch_rad, pose.roll_rad)
    )
    q = message.pose.orientation
    q.w = cr * cp * cy + sr * sp * sy
    q.x = sr * cp * cy - cr * sp * sy
    q.y = cr * sp * cy + sr * cp * sy
    q.z = cr * cp * sy - sr * sp * cy
    return message


class LogWriter:
    """A log while it is written, as `NAME.mcap.XXXXXX.part` until `close()` gives it its name. Until then the file
    is locked, which shows other processes that it still grows.

    Chunks are uncompressed, so that every picture is in the file byte for byte, and is read by its offset.
    Pictures and other messages have separate chunks, except in copies of other programs' logs. All messages of one
    frame share a log time and a sequence number (the frame's number in the log). Messages of one topic stay in the
    order of writing, whatever their times. In text that is not UTF-8, such as a file's name, invalid bytes are
    escaped.

    ``live=True`` writes the open chunks to the disk twice a second, so that a killed process or a power failure
    costs at most a second. Imports leave it off: their bytes then depend only on their input.

    As a context manager, it closes the log, or discards it after an exception. A live recording is kept even then:
    nobody can record it again.
    """

    def __init__(
        self,
        path: Path,
        metadata: dict[str, str] | None,
        *,
        overwrite: bool = False,
        live: bool = False,
        profile: str = topics.PROFILE,
    ) -> None:
        """`metadata`: the source of the log; None for copies of other programs' logs without metadata.

        Raises UserError if `path` exists and may not be overwritten, or cannot be written.
        """
        files.refuse_existing(path, overwrite)
        self.path = path
        self.part = files.part_path(path)
        self._overwrite = overwrite
        self._live = False  # until its beginning is written, there is nothing to keep
        self._is_broken = False
        self._is_whole = False
        self._last_flush_s = time.monotonic()
        self._adders: dict[str, AddMessage] = {}
        self._schemas: dict[str, int] = {}
        self._has_messages = False
        self.same_as = ""
        """Fingerprint of the log that is rewritten; empty for other logs."""
        self._rows = WrittenRows(metadata, path)
        self._sizes = PictureSizes()
        self._sync: files.BackgroundSync | None = None
        self._folders: list[Path] = []
        try:
            self._folders = files.make_folder(path.parent)
            self._stream = self.part.open("xb")
        except OSError as error:
            files.remove_empty(self._folders)
            raise self._broken(error) from None
        try:
            self._begin(metadata, live, profile)
        except BaseException:
            self.discard()
            raise
        self._live = live

    def _begin(self, metadata: dict[str, str] | None, live: bool, profile: str) -> None:
        with contextlib.suppress(OSError):  # a file system without locks
            lock(self._stream)
        if live:
            self._sync = files.BackgroundSync(self._stream.fileno())
        self._chunks = SplitChunks(self._stream, is_split=metadata is not None)
        self._copied_channels = CopiedChannels(self._chunks.mcap)
        self._to_disk(self._chunks.mcap.start, profile, f"{topics.LIBRARY} {version_of()}")
        if metadata is not None:
            self.add_metadata(topics.SESSION_METADATA, {"toolkit": version_of(), **metadata})

    def picture(
        self, camera: Camera, time_ns: int, sequence: int, picture: bytes, size: tuple[int, int] | None = None
    ) -> None:
        """Write a camera's JPEG or PNG, byte for byte. `size`: its width and height, if known already."""
        kind = "png" if picture.startswith(PNG_START) else "jpeg"
        self._sizes.add(topics.camera_topic(camera), sequence, size or width_and_height(picture))
        self._image(topics.camera_topic(camera), time_ns, sequence, picture, kind)

    def crop(self, time_ns: int, sequence: int, png: bytes) -> None:
        self._image(topics.PILOT_INPUT, time_ns, sequence, png, "png")

    def vehicle(self, time_ns: int, sequence: int, state: VehicleState, gap: MeantGap | None = None) -> None:
        """Write a vehicle state. `gap`: time before this row that was left out on purpose; an event has the
        reason."""
        if gap is not None:
            state.not_recorded_s = gap.seconds
        self._write(topics.VEHICLE, state, time_ns, sequence)
        self._rows.add(sequence, time_ns, state)
        if gap is not None:
            self.event(time_ns, str(gap), name="recorder")

    def command(self, time_ns: int, sequence: int, command: PilotCommand) -> None:
        self._write(topics.PILOT_COMMAND, command, time_ns, sequence)

    def message(self, topic: str, time_ns: int, sequence: int, message: Message) -> None:
        """Write a message on any topic of the registry. Raises ValueError for another type of message."""
        name, expected = message.DESCRIPTOR.full_name, topics.TOPICS[topic].message.name
        if name != expected:
            raise ValueError(f"{topic}: a {name}, not a {expected}")
        self._write(topic, message, time_ns, sequence)

    def prediction(self, run: str, time_ns: int, sequence: int, prediction: Prediction) -> None:
        self._write(topics.prediction_topic(_utf8(run)), prediction, time_ns, sequence)

    def pose(self, time_ns: int, sequence: int, pose: PoseInFrame) -> None:
        self._write(topics.POSE, pose, time_ns, sequence)
        self._rows.add_pose(sequence, pose.pose)

    def event(self, time_ns: int, text: str, level: EventLevel = "INFO", name: str = "") -> None:
        """Write an event: `text` is what happened, `name` is where (`recorder`, `drive`)."""
        message = LogMessage(
            timestamp=timestamp(time_ns),
            level=LogMessage.Level.Value(level),
            message=_utf8(text),
            name=_utf8(name),
        )
        self._write(topics.EVENTS, message, time_ns, 0)

    def copy(self, schema: Schema | None, channel: Channel, message: McapMessage, sequence: int) -> None:
        """Write a message of another log, unchanged except for its sequence number. Raises LogError, and writes
        nothing, if a vehicle state cannot be decoded."""
        is_picture = is_image_channel(schema, channel)
        state: VehicleState | None = None
        if channel.topic == topics.VEHICLE and schema is not None and schema.name == topics.VEHICLE_STATE.name:
            try:
                state = VehicleState.FromString(message.data)
            except DecodeError:
                raise LogError(
                    f"{self.path}: cannot be made: row {message.sequence} on {topics.VEHICLE} of the original is"
                    " not a vehicle state; `bc-log recover` leaves it out"
                ) from None
        number_of = partial(self._copied_channels.number_of, schema, channel)
        add = partial(self._chunks.add, number_of, is_picture=is_picture)
        self._message(add, message.log_time, message.publish_time, sequence, message.data)
        if state is not None:
            self._rows.add(sequence, message.log_time, state)
        elif channel.topic == topics.POSE and schema is not None and schema.name == topics.POSE_IN_FRAME.name:
            with contextlib.suppress(DecodeError):
                self._rows.add_pose(sequence, PoseInFrame.FromString(message.data).pose)
        elif channel.topic == topics.EVENTS and schema is not None and schema.name == topics.LOG_MESSAGE.name:
            with contextlib.suppress(DecodeError):
                self._rows.add_event(message.log_time, LogMessage.FromString(message.data).message)
        elif is_picture and channel.topic in topics.CAMERA_TOPICS:
            at, length = image_data(message.data, 0, len(message.data))
            if at >= 0:
                size = width_and_height(message.data[at : at + length])
                self._sizes.add(channel.topic, sequence, size)

    def copy_attachment(self, attachment: Attachment) -> None:
        self._to_disk(
            self._chunks.mcap.add_attachment,
            attachment.create_time,
            attachment.log_time,
            attachment.name,
            attachment.media_type,
            attachment.data,
        )

    @property
    def bytes_written(self) -> int:
        """The size of the file until now, without the open chunks."""
        return self._stream.tell()

    @property
    def notices(self) -> list[str]:
        """Lines to print about pictures of different sizes."""
        return self._sizes.notices()

    def flush_if_due(self) -> None:
        """Close the open chunks if the last flush is long enough ago. Call it also if nothing arrives."""
        now_s = time.monotonic()
        if self._sync is not None and now_s - self._last_flush_s >= FLUSH_S:
            self._to_disk(self._chunks.flush)
            self._to_disk(self._sync.request)
            self._last_flush_s = now_s

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        escaped = {_utf8(key): _utf8(value) for key, value in values.items()}
        self._to_disk(self._chunks.mcap.add_metadata, _utf8(name), escaped)

    def close(self) -> None:
        """Write the summary and give the log its name.

        Raises UserError if the name was taken meanwhile: the error names the complete temporary file. After any
        other exception, also Ctrl-C, nothing stays, except a live recording, which is finished.
        """
        with uninterrupted() if self._live else contextlib.nullcontext():
            try:
                self.finish()
                self.publish()
            except BaseException:
                if not self._is_whole:
                    (self._abandon if self._live else self.discard)()
                raise

    def finish(self) -> None:
        """Write the summary; the log still has its temporary name (`part`)."""
        if len(self._rows):
            mixed = self._sizes.mixed()
            sizes = {
                "first_picture_px": json.dumps(self._sizes.first()),
                **({"picture_sizes": json.dumps(mixed)} if mixed else {}),
            }
            self.add_metadata(topics.QUALITY_METADATA, self._rows.findings().as_metadata() | sizes)
        if self.same_as:
            self._to_disk(self._chunks.flush)
            about = {"fingerprint": self.same_as, "chunks": self._chunks.content_digest}
            self.add_metadata(topics.REWRITTEN_METADATA, about)
        self._to_disk(self._finish)

    def publish(self) -> None:
        """Give the finished log its name. Raises as `close`."""
        with uninterrupted():
            self._is_whole = True  # from now on, errors name the temporary file
            files.publish(self.part, self.path, self._overwrite)

    def discard(self) -> None:
        """Remove this log, and the folders that were made for it."""
        with uninterrupted():
            self._abandon()
            self.part.unlink(missing_ok=True)
            files.remove_empty(self._folders)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if not self._stream.closed:  # not closed before by its user
                self._end(kind is None)
        except KeyboardInterrupt:
            if not self._stream.closed:  # it came too early for `_end`
                self._end(is_sound=False)
            raise

    def _end(self, is_sound: bool) -> None:
        is_kept = self._live and self._has_messages
        if self._is_broken and is_kept:
            self._abandon()  # the error names the file, which stays
        elif is_sound or is_kept:
            self.close()
        else:
            self.discard()

    def _image(self, topic: str, time_ns: int, sequence: int, data: bytes, kind: str) -> None:
        # Rerun gives every entity a frame of this name; without it, its views warn of a missing frame.
        frame_id = f"tf#{topic}"
        seconds, nanos = divmod(time_ns, 1_000_000_000)
        stamp = {"seconds": seconds, "nanos": nanos}  # a Timestamp would take a third of the time
        image = CompressedImage(timestamp=stamp, frame_id=frame_id, data=data, format=kind)  # type: ignore[arg-type]
        self._write(topic, image, time_ns, sequence)

    def _write(self, topic: str, message: Message, time_ns: int, sequence: int) -> None:
        add = self._adders.get(topic)
        if add is None:
            is_picture = message.DESCRIPTOR.full_name == topics.COMPRESSED_IMAGE.name
            number_of = cache(partial(self._register, topic, type(message)))
            add = self._adders[topic] = partial(self._chunks.add, number_of, is_picture=is_picture)
        self._message(add, time_ns, time_ns, sequence, message.SerializeToString())

    def _message(self, add: AddMessage, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        try:  # as `_to_disk`, without another call for every message
            add(log_time, data, publish_time, sequence)
        except OSError as error:
            raise self._broken(error) from None
        self._has_messages = True
        if self._live:
            self.flush_if_due()

    def _register(self, topic: str, message: type[Message]) -> int:
        name = message.DESCRIPTOR.full_name
        if name not in self._schemas:
            self._schemas[name] = register_schema(self._chunks.mcap, message)
        return self._chunks.mcap.register_channel(topic, MessageEncoding.Protobuf, self._schemas[name])

    def _finish(self) -> None:
        self._chunks.finish()
        self._stream.flush()
        if self._sync is not None:
            self._sync.close()
        os.fsync(self._stream.fileno())
        self._stream.close()

    def _to_disk(self, action: Callable[..., Any], *arguments: Any, **options: Any) -> None:
        try:
            action(*arguments, **options)
        except OSError as error:
            raise self._broken(error) from None

    def _broken(self, error: OSError) -> UserError:
        """The error for a disk that is full or gone."""
        self._is_broken = True
        if not (self._live and self._has_messages):
            return UserError(f"{self.path}: cannot be written ({error.strerror}); nothing was kept of it")
        return UserError(
            f"{self.part}: cannot be written any further ({error.strerror}); it has all rows until now:"
            f" make room and run {recovery(self.part)}"
        )

    def _abandon(self) -> None:
        if self._sync is not None:
            with contextlib.suppress(OSError):
                self._sync.close()
        self._stream.raw.close()  # flushing the buffer would meet the full disk again


def _utf8(text: str) -> str:
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def close_with_tags(writer: LogWriter, tags: Sequence[Tag]) -> None:
    """Finish a log. Once it has its name, it has its tags."""
    with uninterrupted():
        writer.close()
        write_tags(writer.path, tags)


def write_tags(log: Path, tags: Sequence[Tag]) -> None:
    if tags:
        with Log(log) as written:
            add_tags(log, written.fingerprint, tags)
