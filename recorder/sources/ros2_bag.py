"""Reads ROS 2 bags: the files of a bag's folder, and the messages in SQLite databases.

The package rosbags is not used for databases: its decoder generates and runs code from the bag's definitions.
Layout: https://github.com/ros2/rosbag2, rosbag2_storage_sqlite3 and rosbag2_storage's metadata.
"""

from __future__ import annotations

import os
import re
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import takewhile
from pathlib import Path
from typing import Any, Final, TypeAlias

from mcap.records import Channel, Message, Schema

from common import Skipped
from common.errors import brief
from common.progress import track
from common.untrusted import read_bounded, real_path
from recorder.errors import RecordingError
from recorder.sources.mcap_messages import needs_ros

Stored: TypeAlias = tuple[Schema, Channel, Message]

METADATA: Final = "metadata.yaml"
MCAP, SQLITE = ".mcap", ".db3"

_READABLE: Final = ("none", "storage", "", "null", "~")  # compression modes: of files, not of messages
_MAX_METADATA_BYTES: Final = 1 << 22
_MAX_EVENTS: Final = 50_000  # of YAML
_MAX_DEPTH: Final = 20
_MAX_VALUE_BYTES: Final = 1 << 28  # of a message; SQLite's own limit is four times larger
_STEPS_BETWEEN_SIGNALS: Final = 1000  # of SQLite's machine; steps with large values take milliseconds

_SEPARATOR: Final = "=" * 80
_ACKERMANN: Final = f"""\
float32 steering_angle
float32 steering_angle_velocity
float32 speed
float32 acceleration
float32 jerk
{_SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
# Older bags lack definitions, and rosbags does not have ackermann_msgs, which most bags of model cars use.
_DEFINITIONS: Final = {
    "ackermann_msgs/msg/AckermannDrive": _ACKERMANN,
    "ackermann_msgs/msg/AckermannDriveStamped": (
        "std_msgs/Header header\nackermann_msgs/AckermannDrive drive\n"
        f"{_SEPARATOR}\nMSG: ackermann_msgs/AckermannDrive\n{_ACKERMANN}"
    ),
}


def is_bag(folder: Path) -> bool:
    """True if `folder` looks like a ROS 2 bag."""
    try:
        names = {path.name for path in folder.iterdir()}
    except OSError:
        return False
    return METADATA in names and any(re.search(r"\.(mcap|db3)(\.|$)", name) for name in names)


def bag_files(folder: Path, skipped: Skipped) -> list[Path]:
    """The bag's files in order. Files that are missing, or that metadata.yaml does not name, are skipped.

    Raises RecordingError if metadata.yaml cannot be read, or all its files are missing.
    """
    root = Path(os.path.realpath(folder))
    try:
        inside = {
            path.name: path for path in folder.iterdir() if path.is_file() and real_path(path).is_relative_to(root)
        }
        text = read_bounded(inside[METADATA], _MAX_METADATA_BYTES)
    except (OSError, KeyError):
        raise RecordingError(f"{folder}: {METADATA} cannot be read; `ros2 bag reindex` writes a new one") from None
    metadata = _parse(folder, text)
    information = metadata.get("rosbag2_bagfile_information") if isinstance(metadata, dict) else None
    names = information.get("relative_file_paths") if isinstance(information, dict) else None
    if not isinstance(information, dict) or not isinstance(names, list):
        raise RecordingError(f"{folder}: {METADATA} names no files; `ros2 bag reindex` writes a new one")
    if str(information.get("compression_mode")).lower() not in _READABLE:
        raise RecordingError(f"{folder}: a compressed bag, which is not read; `ros2 bag convert` unpacks it")
    listed = list(dict.fromkeys(re.split(r"[/\\]", name)[-1] for name in names if isinstance(name, str)))
    files = []
    for name in listed:
        if name in inside and name.endswith((MCAP, SQLITE)):
            files.append(inside[name])
        else:
            skipped.add("files of the bag that are not there, or lead out of it", brief(name))
    for name in sorted(inside.keys() - set(listed)):
        if name.endswith((MCAP, SQLITE)):
            skipped.add(f"files of the bag that {METADATA} does not name", brief(name))
        elif name.endswith("-wal") and inside[name].stat().st_size:
            skipped.add(
                "journals of messages that are not in the bag; `ros2 bag info` moves them there", brief(name)
            )
    if not files:
        raise RecordingError(f"{folder}: all files that {METADATA} names are missing")
    return files


@dataclass(frozen=True)
class SqliteFile:
    """One SQLite database of a bag. All methods raise RecordingError if it cannot be read."""

    path: Path
    opened: ExitStack = field(default_factory=ExitStack)
    """Closes the database from which single messages are read."""

    def types(self, skipped: Skipped) -> dict[str, str]:
        """The type of the messages on each topic."""
        with self._open() as database:
            return {str(name): str(kind) for name, kind in database.execute("SELECT name, type FROM topics")}

    def places(self, topic: str, bar: str) -> Iterator[tuple[int, Callable[[], Stored]]]:
        """The times of the messages on `topic`, and functions that read them, with a progress bar named `bar`."""
        with self._open() as database:
            channels = self._channels(database, topic)
            where = f"WHERE topic_id IN ({', '.join('?' * len(channels))})"
            ((count,),) = database.execute(f"SELECT COUNT(*) FROM messages {where}", tuple(channels))
            order = f"SELECT id, topic_id, timestamp FROM messages {where} ORDER BY timestamp, id"
            for number, channel, time_ns in track(database.execute(order, tuple(channels)), bar, count):
                yield time_ns, partial(self._message, channels[channel], number, time_ns)

    def _message(self, channel: tuple[Schema, Channel], number: int, time_ns: int) -> Stored:
        with self._readable():
            ((data,),) = self._kept_open.execute("SELECT data FROM messages WHERE id = ?", (number,))
        return *channel, Message(channel[1].id, time_ns, data, time_ns, 0)

    def _channels(self, database: sqlite3.Connection, topic: str) -> dict[int, tuple[Schema, Channel]]:
        channels = {}
        for number, kind, encoding in database.execute(
            "SELECT id, type, serialization_format FROM topics WHERE name = ?", (topic,)
        ):
            schema = Schema(number, self._definition(database, str(kind)), "ros2msg", str(kind))
            channels[number] = schema, Channel(number, topic, str(encoding), {}, number)
        return channels

    @cached_property
    def _kept_open(self) -> sqlite3.Connection:
        return self.opened.enter_context(self._open())

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        with self._readable():
            address = f"{self.path.absolute().as_uri()}?mode=ro&immutable=1"
            # An iterator that was left early is closed by whichever thread collects garbage.
            with closing(sqlite3.connect(address, uri=True, check_same_thread=False)) as database:
                self.opened.callback(database.close)  # also after an error that keeps an iterator alive
                # The file may define views that never end, and triggers: none may run.
                database.execute("PRAGMA trusted_schema = OFF")
                database.execute("PRAGMA query_only = ON")
                database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MAX_VALUE_BYTES)
                # Python handles signals only between its own steps, so SQLite calls it now and then.
                database.set_progress_handler(lambda: 0, _STEPS_BETWEEN_SIGNALS)
                self._refuse_views(database)
                yield database

    @contextmanager
    def _readable(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, TypeError, ValueError, OverflowError) as error:
            if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_INTERRUPT:
                raise KeyboardInterrupt from None  # a signal during the progress handler
            raise RecordingError(f"{self.path}: cannot be read as a ROS 2 bag ({brief(str(error))})") from None

    def _refuse_views(self, database: sqlite3.Connection) -> None:
        """Raise DatabaseError unless topics, messages and definitions are plain tables."""
        for name in ("topics", "messages", "message_definitions"):
            # SQLite uses this text: a view may be listed as a table, and a virtual table runs code.
            made_by = database.execute("SELECT sql FROM sqlite_master WHERE lower(name) = ?", (name,))
            if not all(str(sql).startswith("CREATE TABLE ") for (sql,) in made_by):
                raise sqlite3.DatabaseError(f"{name} is not a table")

    def _definition(self, database: sqlite3.Connection, kind: str) -> bytes:
        tables = database.execute("SELECT name FROM sqlite_master WHERE name = 'message_definitions'")
        if tables.fetchone() is not None:
            row = database.execute(
                "SELECT encoded_message_definition FROM message_definitions"
                " WHERE topic_type = ? AND encoding = 'ros2msg'",
                (kind,),
            ).fetchone()
            if row is not None:
                return str(row[0]).encode()
        text = _DEFINITIONS.get(kind) or self._standard_definition(kind)
        if text is None:
            raise RecordingError(
                f"{self.path}: the bag does not hold the definition of {brief(kind)}; where that type is known,"
                " `ros2 bag convert` to MCAP adds it"
            )
        return text.encode()

    def _standard_definition(self, kind: str) -> str | None:
        try:
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise RecordingError(f"{self.path}: {needs_ros()}") from None
        store = get_typestore(Stores.LATEST)
        return store.generate_msgdef(kind, ros_version=2)[0] if kind in store.fielddefs else None


def _parse(folder: Path, text: bytes) -> object:
    try:
        return yaml_content(text)
    except ImportError:
        raise RecordingError(f"{folder}: {needs_ros()}") from None
    except Exception:  # ruamel raises nearly anything on other text
        return None


def yaml_content(text: bytes) -> Any:
    """The first document of untrusted YAML: mappings, lists and texts; None for a repetition.

    ruamel's loaders take seconds for 40 KB of brackets, and never end with a kilobyte of merged mappings. Its
    parser returns one event at a time, and repeats nothing. Raises ImportError without ruamel.yaml, and any
    exception for other text, or for too many events or levels.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.events import (
        CollectionEndEvent,
        DocumentStartEvent,
        MappingStartEvent,
        ScalarEvent,
        SequenceStartEvent,
    )

    def bounded() -> Iterator[Any]:
        for number, event in enumerate(YAML(typ="safe", pure=True).parse(text)):
            if number == _MAX_EVENTS:
                raise ValueError(f"more than {_MAX_EVENTS:,} events")
            yield event

    events = bounded()

    def value(event: Any, depth: int = 0) -> Any:
        if depth > _MAX_DEPTH:
            raise ValueError(f"deeper than {_MAX_DEPTH} levels")
        before_end = takewhile(lambda inner_event: not isinstance(inner_event, CollectionEndEvent), events)
        inner = (value(inner_event, depth + 1) for inner_event in before_end)
        if isinstance(event, SequenceStartEvent):
            return list(inner)
        if isinstance(event, MappingStartEvent):
            return {key: content for key, content in zip(inner, inner, strict=True) if isinstance(key, str)}
        return event.value if isinstance(event, ScalarEvent) else None

    for event in events:
        if isinstance(event, DocumentStartEvent):
            return value(next(events))
    return None
