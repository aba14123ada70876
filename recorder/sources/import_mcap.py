"""Imports other programs' MCAP logs, and ROS 2 bags.

The user names the topic of the pictures, and the topic and the field of the steering.
"""

from __future__ import annotations

import re
import shlex
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from mcap.records import Channel, Message, Schema
from numpy.typing import NDArray

from common import Skipped
from common.errors import brief
from common.files import PART_SUFFIX
from common.progress import track
from common.untrusted import open_regular, real_path
from recorder.errors import RecordingError, recovery
from recorder.log.reader import Log
from recorder.log.session_car import Car
from recorder.mcap.mcap_file import WITHOUT_CRCS
from recorder.mcap.message_index import LAST_TIME_NS
from recorder.pictures.decoding import is_whole_picture
from recorder.sources.imported_rows import (
    NOT_WHOLE,
    STEERING_OUT_OF_RANGE,
    Imported,
    ImportedRow,
    SkippedEvents,
    recording_metadata,
    vehicle_state,
    write_log,
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
from recorder.sources.settings import Topics
from recorder.topics import PROFILE

MAX_STEERING_AGE_S: Final = 1.0

# magic, the header's opcode and length, the length of its profile
_OWN_HEADER: Final = re.compile(rb"\x89MCAP0\r\n\x01.{8}\x02\0\0\0" + PROFILE.encode(), re.DOTALL)


@dataclass(frozen=True)
class _McapFile:
    path: Path

    def types(self, skipped: Skipped) -> dict[str, str]:
        """The type of the messages on each topic. An unfinished file is noted in `skipped`."""
        with Log(self.path) as log:
            if log.notice:
                skipped.add("files that are not whole", log.notice)
            return log.schemas

    def has_crcs(self) -> bool:
        with Log(self.path) as log:
            return log.has_crcs

    def messages(self, topic: str, bar: str) -> Iterator[tuple[Schema | None, Channel, Message]]:
        """The messages on `topic` in the file's order, with a progress bar named `bar`."""
        with Log(self.path) as log:
            for chunk in track(log.chunks, bar, len(log.chunks)):
                for schema, channel, message in log.messages_of(chunk):
                    if channel.topic == topic:
                        yield schema, channel, message


_File = _McapFile | SqliteFile  # one file of a recording


_Steering = tuple[NDArray[np.int64], NDArray[np.float64]]  # times in ns, ascending, and the steering at each


def is_own_log(source: Path) -> bool:
    """True if `source` is a log of this toolkit: an MCAP file whose header names its profile."""
    try:
        with open_regular(source) as stream:
            return _OWN_HEADER.match(stream.read(64)) is not None
    except OSError:
        return False


def import_mcap(
    source: Path, log: Path, topics: Topics, *, car: Car | None = None, overwrite: bool = False
) -> Imported:
    """Write the pictures of another program's log to `log`, byte for byte, each with the last steering before it.

    `topics` names the topic of the pictures (foxglove.CompressedImage or sensor_msgs/CompressedImage, JPEG or
    PNG), and the topic and field of the steering, such as /drive.drive.steering_angle or /joy.axes.0. Its scale
    converts to -1 (left) .. 1 (right): -1 for ROS's -1..1, -2.29 for radians.
    Pictures are left out if the last steering is over a second old. Speed is NaN, the pedals are 0. Raises
    LogError if a chunk of it is damaged. Else as `import_udacity`.
    """
    if topics == Topics() and is_own_log(source):
        raise RecordingError(f"{source}: a log of this toolkit, {_what_to_do_instead(source, log)}")
    image, wanted = topics.image, topics.steering
    if image is None or wanted is None:
        raise RecordingError(
            f"{source}: which topics? Give --image TOPIC and --steering TOPIC.FIELD;"
            f" `bc-log info {shlex.quote(str(source))}` lists them"
        )
    events = SkippedEvents()
    skipped = events.skipped
    files = _files(source, skipped)
    types = {topic: kind for file in files for topic, kind in file.types(skipped).items()}
    steering_topic, field = _split_field(source, wanted, types)
    _check_image_topic(source, image, types)
    steering = _read_steering(source, files, steering_topic, field, topics.steering_scale, skipped)
    rows = _rows(files, image, steering, f"importing {source.name}", skipped)
    metadata = recording_metadata("ros2 bag" if source.is_dir() else "mcap", source, car) | {
        "image_topic": image,
        "steering_topic": wanted,
        "steering_scale": repr(topics.steering_scale),
    }
    has_crcs = all(file.has_crcs() for file in files if isinstance(file, _McapFile))
    warnings = [] if has_crcs else [f"{metadata['recording']}: {WITHOUT_CRCS}"]
    without_rows = f"{source}: no picture on {image} can be used"
    return write_log(log, metadata, rows, events, without_rows, warnings=warnings, overwrite=overwrite)


def _what_to_do_instead(source: Path, log: Path) -> str:
    if source.suffix == PART_SUFFIX:
        return f"still unfinished: finish it with {recovery(source)}"
    if real_path(source).parent == real_path(log).parent:
        return "and a session already: `bc-index` takes it in"
    return f"which needs no import: copy it into {log.parent}/"


def topics_in(source: Path, skipped: Skipped) -> dict[str, str]:
    """The topics of another program's log or a bag, with their messages' types. Raises UserError."""
    return {topic: kind for file in _files(source, skipped) for topic, kind in file.types(skipped).items()}


def _files(source: Path, skipped: Skipped) -> list[_File]:
    if source.is_dir():
        paths = bag_files(source, skipped)
    elif source.suffix == SQLITE:
        raise RecordingError(f"{source}: a part of a ROS 2 bag; give the folder that it lies in")
    else:
        paths = [source]
    return [SqliteFile(path) if path.suffix == SQLITE else _McapFile(path) for path in paths]


def _split_field(source: Path, text: str, types: dict[str, str]) -> tuple[str, str]:
    """The topic and the field that `text` names; the field is empty if `text` names only a topic."""
    topics = [topic for topic in types if text == topic or text.startswith(f"{topic}.")]
    if not topics:
        raise RecordingError(
            f"{source}: {brief(text)!r} names no topic; --steering is TOPIC.FIELD, and {_listed(types)}"
        )
    topic = max(topics, key=len)
    return topic, text[len(topic) + 1 :]


def _check_image_topic(source: Path, topic: str, types: dict[str, str]) -> None:
    if topic not in types:
        raise RecordingError(f"{source}: no topic {brief(topic)!r} for --image; {_listed(types)}")
    if not is_picture_type(types[topic]):
        raise RecordingError(
            f"{source}: the messages on {brief(topic)} are {_type(types[topic])}; --image needs"
            f" foxglove.CompressedImage or sensor_msgs/CompressedImage; {_listed(types)}"
        )


def _listed(types: dict[str, str]) -> str:
    if not types:
        return "it has no topics"
    return "its topics are " + ", ".join(f"{brief(topic)} ({_type(types[topic])})" for topic in sorted(types))


def _type(name: str) -> str:
    return brief(name) or "of no type"


def _read_steering(
    source: Path, files: list[_File], topic: str, field: str, scale: float, skipped: Skipped
) -> _Steering:
    times, values = array("q"), array("d")
    problem = "there is no message on it"
    for time_ns, name, message in _decoded(files, topic, f"reading {brief(topic)}", skipped):
        try:
            values.append(number_in(message, field) * scale)
        except FieldError as error:
            if error.is_final:
                raise RecordingError(f"{source}: --steering: on {brief(topic)}, {error}") from None
            skipped.add("messages without a steering", f"{name}: {error}")
        else:
            times.append(time_ns)
    if not times:
        problem = "; ".join(skipped.lines(max_names=1)) or problem
        raise RecordingError(f"{source}: --steering: no number can be read on {brief(topic)}: {problem}")
    order = np.argsort(np.array(times, np.int64), kind="stable")
    return np.array(times, np.int64)[order], np.array(values, np.float64)[order]


def _rows(
    files: list[_File], topic: str, steering: _Steering, bar: str, skipped: Skipped
) -> Iterator[ImportedRow]:
    steering_ns, values = steering
    for time_ns, name, message in _decoded(files, topic, bar, skipped):
        at = int(np.searchsorted(steering_ns, time_ns, "right")) - 1
        if at < 0:
            skipped.add("pictures before the first steering", name)
            continue
        if time_ns - int(steering_ns[at]) > MAX_STEERING_AGE_S * 1e9:
            skipped.add(f"pictures whose last steering is over {MAX_STEERING_AGE_S:g} s old", name)
            continue
        try:
            picture = picture_in(message)
        except FieldError:
            skipped.add("messages without a picture", name)
            continue
        if not is_whole_picture(picture):
            skipped.add(NOT_WHOLE, name)
            continue
        value = float(values[at])
        if abs(value) > 1:
            skipped.add(STEERING_OUT_OF_RANGE, f"{name}: {value:g}")
        yield ImportedRow(time_ns, vehicle_state(value), [("center", picture)])


def _decoded(files: list[_File], topic: str, bar: str, skipped: Skipped) -> Iterator[tuple[int, str, object]]:
    """The messages on `topic`: log time, name for people, content."""
    for file in files:
        decoders: dict[int, Decoder] = {}
        for schema, channel, message in file.messages(topic, bar):
            time_ns = message.log_time
            if not isinstance(time_ns, int) or not 0 <= time_ns <= LAST_TIME_NS:
                skipped.add("messages of a time that no log can hold", f"{brief(topic)} at {brief(repr(time_ns))}")
                continue
            name = f"{brief(topic)} at {time_ns / 1e9:.3f} s"
            if channel.id not in decoders:
                try:
                    decoders[channel.id] = decoder_for(schema, channel)
                except RecordingError as error:
                    raise RecordingError(f"{file.path}: {error}") from None
            try:
                content = decoders[channel.id](message.data)
            except Exception:  # decoders of untrusted definitions may raise anything
                skipped.add("messages that cannot be decoded", name)
                continue
            yield time_ns, name, content
