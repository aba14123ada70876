"""Reads other programs' MCAP logs, and ROS 2 bags.

The user names the topic of the pictures, and the topic and the field of the steering.
"""

from __future__ import annotations

import re
import shlex
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
from mcap.records import Channel, Message, Schema
from numpy.typing import NDArray

from common import Skipped
from common.car import Camera
from common.errors import brief
from common.files import PART_SUFFIX
from common.progress import track
from common.untrusted import open_regular, real_path
from recorder.errors import RecordingError, recovery
from recorder.log.reader import Log
from recorder.log.session_car import Car
from recorder.mcap.mcap_file import WITHOUT_CRCS, Chunk
from recorder.sources.compressed_video import VideoDecoder, is_video_type, video_in
from recorder.sources.imported_rows import (
    VIDEOS_ENCODED_ANEW,
    RawRecording,
    RecordedRow,
    UnreadablePictureError,
    recording_metadata,
)
from recorder.sources.mcap_messages import (
    Decoder,
    FieldError,
    decoder_for,
    is_picture_type,
    number_in,
    picture_in,
)
from recorder.sources.ros2_bag import SQLITE, SqliteFile, bag_files
from recorder.sources.settings import ImportSettings
from recorder.topics import PROFILE

_CHUNKS_KEPT: Final = 4  # unpacked, for messages that are not in the order of their times

# magic, the header's opcode and length, the length of its profile
_OWN_HEADER: Final = re.compile(rb"\x89MCAP0\r\n\x01.{8}\x02\0\0\0" + PROFILE.encode(), re.DOTALL)

_Stored: TypeAlias = tuple[Schema | None, Channel, Message]
_Place: TypeAlias = tuple[int, Callable[[], _Stored]]


class _McapFile:
    def __init__(self, path: Path, opened: ExitStack) -> None:
        self.path = path
        self.log = opened.enter_context(Log(path))
        self._kept: dict[int, list[_Stored]] = {}

    def types(self, skipped: Skipped) -> dict[str, str]:
        """An unfinished file is noted in `skipped`."""
        if self.log.notice:
            skipped.add("files that are not whole", self.log.notice)
        return self.log.schemas

    def places(self, topic: str, bar: str) -> Iterator[_Place]:
        for chunk in track(self.log.chunks, bar, len(self.log.chunks)):
            for number, (_, channel, message) in enumerate(self.log.messages_of(chunk)):
                if channel.topic == topic:
                    yield message.log_time, partial(self._message, chunk, number)

    def _message(self, chunk: Chunk, number: int) -> _Stored:
        if chunk.start not in self._kept:
            while len(self._kept) >= _CHUNKS_KEPT:
                self._kept.pop(next(iter(self._kept)))
            self._kept[chunk.start] = list(self.log.messages_of(chunk))
        return self._kept[chunk.start][number]


def is_own_log(source: Path) -> bool:
    """True if `source` is a log of this toolkit: an MCAP file whose header names its profile."""
    try:
        with open_regular(source) as stream:
            return _OWN_HEADER.match(stream.read(64)) is not None
    except OSError:
        return False


def read_log(
    source: Path, settings: ImportSettings, skipped: Skipped, car: Car | None = None, log: Path | None = None
) -> RawRecording:
    """The pictures of another program's log, and its steering as commands. `log`: where it will be written.

    `settings` names the topic of the pictures (foxglove.CompressedImage or sensor_msgs/CompressedImage, JPEG or
    PNG), those of side cameras, and the topic and field of the steering, such as /drive.drive.steering_angle or
    /joy.axes.0. Speed is unknown, the pedals are 0. Raises RecordingError; LogError if a chunk is damaged.
    """
    if settings.image is None and settings.steering is None and is_own_log(source):
        raise RecordingError(f"{source}: a log of this toolkit, {_what_to_do_instead(source, log)}")
    wanted = settings.steering
    if settings.image is None or wanted is None:
        raise RecordingError(
            f"{source}: which topics? Give --image TOPIC and --steering TOPIC.FIELD;"
            f" `bc-log info {shlex.quote(str(source))}` lists them"
        )
    cameras: dict[Camera, str] = {"center": settings.image, **side_cameras(settings)}
    with ExitStack() as opened:
        files = _files(source, skipped, opened)
        types = {topic: kind for file in files for topic, kind in file.types(skipped).items()}
        steering_topic, field = _split_field(source, wanted, types)
        for camera, topic in cameras.items():
            _check_image_topic(source, topic, types, "--image" if camera == "center" else "--camera")
        commands = _commands(source, files, steering_topic, field, skipped)
        rows = [
            row
            for camera, topic in cameras.items()
            for row in _pictures(files, topic, types[topic], None if len(cameras) == 1 else camera)
        ]
        metadata = recording_metadata("ros2 bag" if source.is_dir() else "mcap", source, car) | {
            "image_topic": settings.image,
            "steering_topic": wanted,
        }
        has_crcs = all(file.log.has_crcs for file in files if isinstance(file, _McapFile))
        return RawRecording(
            source,
            metadata,
            rows,
            noun="messages",
            time_unit="ns",
            commands=commands,
            is_by_arrival=True,
            without_rows=f"{source}: no picture on {settings.image} can be used",
            notices=[VIDEOS_ENCODED_ANEW]
            if any(is_video_type(types[topic]) for topic in cameras.values())
            else [],
            warnings=[] if has_crcs else [f"{metadata['recording']}: {WITHOUT_CRCS}"],
            opened=opened.pop_all(),
        )


def side_cameras(settings: ImportSettings) -> dict[Camera, str]:
    """From `left=TOPIC right=TOPIC`. Raises RecordingError for another form."""
    found: dict[Camera, str] = {}
    for text in settings.camera:
        name, separator, topic = text.partition("=")
        if name not in ("left", "right") or not separator or not topic:
            raise RecordingError(f"--camera {brief(text)}: expected left=TOPIC or right=TOPIC")
        found["left" if name == "left" else "right"] = topic
    return found


def _what_to_do_instead(source: Path, log: Path | None) -> str:
    if source.suffix == PART_SUFFIX:
        return f"still unfinished: finish it with {recovery(source)}"
    if log is None:
        return "which needs no import"
    if real_path(source).parent == real_path(log).parent:
        return "and a session already: `bc-index` takes it in"
    return f"which needs no import: copy it into {log.parent}/"


def topics_in(source: Path, skipped: Skipped) -> dict[str, str]:
    """The topics of another program's log or a bag, with their messages' types. Raises UserError."""
    with ExitStack() as opened:
        files = _files(source, skipped, opened)
        return {topic: kind for file in files for topic, kind in file.types(skipped).items()}


def _files(source: Path, skipped: Skipped, opened: ExitStack) -> list[_McapFile | SqliteFile]:
    if source.is_dir():
        paths = bag_files(source, skipped)
    elif source.suffix == SQLITE:
        raise RecordingError(f"{source}: a part of a ROS 2 bag; give the folder that it lies in")
    else:
        paths = [source]
    return [SqliteFile(path, opened) if path.suffix == SQLITE else _McapFile(path, opened) for path in paths]


def _split_field(source: Path, text: str, types: Mapping[str, str]) -> tuple[str, str]:
    """The topic and the field that `text` names; the field is empty if `text` names only a topic."""
    topics = [topic for topic in types if text == topic or text.startswith(f"{topic}.")]
    if not topics:
        raise RecordingError(
            f"{source}: {brief(text)!r} names no topic; --steering is TOPIC.FIELD, and {_listed(types)}"
        )
    topic = max(topics, key=len)
    return topic, text[len(topic) + 1 :]


def _check_image_topic(source: Path, topic: str, types: Mapping[str, str], flag: str) -> None:
    if topic not in types:
        raise RecordingError(f"{source}: no topic {brief(topic)!r} for {flag}; {_listed(types)}")
    if not is_picture_type(types[topic]) and not is_video_type(types[topic]):
        raise RecordingError(
            f"{source}: the messages on {brief(topic)} are {_type(types[topic])}; {flag} needs"
            " foxglove.CompressedImage, foxglove.CompressedVideo or sensor_msgs/CompressedImage;"
            f" {_listed(types)}"
        )


def _listed(types: Mapping[str, str]) -> str:
    if not types:
        return "it has no topics"
    return "its topics are " + ", ".join(f"{brief(topic)} ({_type(types[topic])})" for topic in sorted(types))


def _type(name: str) -> str:
    return brief(name) or "of no type"


def _commands(
    source: Path, files: list[_McapFile | SqliteFile], topic: str, field: str, skipped: Skipped
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The times of the steering's messages, ascending, and the number in each."""
    times, values = array("q"), array("d")
    problem = "there is no message on it"
    for file in files:
        decoders = _Decoders(file.path)
        for time, read in file.places(topic, f"reading {brief(topic)}"):
            name = _name(topic, time)
            if not isinstance(time, int) or not 0 <= time < 2**63:
                skipped.add("messages with a time that no log can hold", name)
                continue
            try:
                values.append(number_in(decoders.content(read()), field))
            except UnreadablePictureError as error:
                skipped.add(str(error), name)
            except FieldError as error:
                if error.is_final:
                    raise RecordingError(f"{source}: --steering: on {brief(topic)}, {error}") from None
                skipped.add("messages without a steering", f"{name}: {error}")
            else:
                times.append(time)
    if not times:
        problem = "; ".join(skipped.lines(max_names=1)) or problem
        raise RecordingError(f"{source}: --steering: no number can be read on {brief(topic)}: {problem}")
    order = np.argsort(np.array(times, np.int64), kind="stable")
    return np.array(times, np.int64)[order], np.array(values, np.float64)[order]


def _pictures(
    files: list[_McapFile | SqliteFile], topic: str, kind: str, camera: Camera | None
) -> Iterator[RecordedRow]:
    """A row for each picture on a topic."""
    for file in files:
        decoders = _Decoders(file.path)
        stored = list(file.places(topic, f"reading {brief(topic)}"))
        places: Sequence[tuple[int, Callable[[], _Stored | bytes]]] = stored
        if is_video_type(kind):
            places = _Video(topic, decoders, stored).places()
        for time, read in places:
            row = RecordedRow(_name(topic, time), time if isinstance(time, int) else -1, camera=camera)
            row.pictures = {camera or "center": partial(_picture, decoders, read)}
            yield row


def _picture(decoders: _Decoders, read: Callable[[], _Stored | bytes]) -> bytes:
    stored = read()
    try:
        return stored if isinstance(stored, bytes) else picture_in(decoders.content(stored))
    except FieldError:
        raise UnreadablePictureError("messages without a picture") from None


class _Video:
    """Decodes the messages of a video: all of them, in the order of their times, also those between the wanted."""

    def __init__(self, topic: str, decoders: _Decoders, places: list[_Place]) -> None:
        self._topic = topic
        self._decoders = decoders
        self._places = sorted(places, key=lambda place: place[0])
        self._decoder: VideoDecoder | None = None
        self._next = 0

    def places(self) -> list[tuple[int, Callable[[], bytes]]]:
        return [(time, partial(self._picture, number)) for number, (time, _) in enumerate(self._places)]

    def _picture(self, wanted: int) -> bytes:
        picture: bytes | None = None
        while self._next <= wanted:
            self._next += 1
            picture = self._decoded(self._places[self._next - 1][1]())
        if picture is None:
            raise UnreadablePictureError(
                "messages of a video without a whole picture (after damage, until a key frame)"
            )
        return picture

    def _decoded(self, stored: _Stored) -> bytes | None:
        try:
            video_format, data = video_in(self._decoders.content(stored))
        except (FieldError, UnreadablePictureError):
            video_format, data = "", b""
        try:
            if self._decoder is None:
                if not video_format:
                    return None
                self._decoder = VideoDecoder(video_format)
            return self._decoder.jpeg(data)
        except RecordingError as error:
            raise RecordingError(f"{brief(self._topic)}: {error}") from None


def _name(topic: str, time: object) -> str:
    return (
        f"{brief(topic)} at {time / 1e9:.3f} s"
        if isinstance(time, int)
        else f"{brief(topic)} at {brief(repr(time))}"
    )


class _Decoders:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._decoders: dict[int, Decoder] = {}

    def content(self, stored: _Stored) -> object:
        """Raises RecordingError if messages of its type cannot be decoded, UnreadablePictureError if this one
        cannot."""
        schema, channel, message = stored
        if channel.id not in self._decoders:
            try:
                self._decoders[channel.id] = decoder_for(schema, channel)
            except RecordingError as error:
                raise RecordingError(f"{self._path}: {error}") from None
        try:
            return self._decoders[channel.id](message.data)
        except Exception:  # decoders of untrusted definitions may raise anything
            raise UnreadablePictureError("messages that cannot be decoded") from None
