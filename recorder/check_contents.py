"""What the messages of a log say when they are looked through: pictures, rows, and how they fit together."""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import cv2
import numpy as np
from google.protobuf.message import DecodeError

from recorder import compressed_image, topics
from recorder.bc_pb2 import VehicleState
from recorder.chunks import StoredMessage, Structure
from recorder.compressed_image import image_data
from recorder.edit import ROW_TOPICS
from recorder.quality import STANDING_MPH, RowFlag, StatesWritten, row_flags, stretches

FROZEN_PICTURES: Final = 3
"""So many equal pictures in a row from a moving car are a frozen camera: a slow one may repeat a picture once."""

_MOST_WAITING: Final = 1500  # pictures that wait to be decoded, some 16 MB

_ROW_FINDINGS: Final[dict[RowFlag, str]] = {
    "gap": "gaps in time",
    "stuck_steering": "stuck steering",
    "out_of_range": "values out of range",
}
_MISFIT: Final = "messages that are not what their schema says"


class Finding(NamedTuple):
    """Something wrong with a log."""

    kind: str
    where: str


@dataclass
class _Pictures:
    """The pictures of one topic until now."""

    keys: list[tuple[int, int]] = field(default_factory=list)  # row and time
    is_repeated: list[bool] = field(default_factory=list)
    last: bytes = b""


class Contents:
    """What the messages say, taken in one by one."""

    def __init__(self, structure: Structure, findings: list[Finding], pool: ThreadPoolExecutor | None) -> None:
        self._topics = {number: channel.topic for number, channel in structure.channels.items()}
        schemas = {
            number: structure.schemas[channel.schema_id].name if channel.schema_id in structure.schemas else ""
            for number, channel in structure.channels.items()
        }
        self._images = {number for number, name in schemas.items() if name == compressed_image.SCHEMA}
        self._vehicle = {
            number
            for number, name in schemas.items()
            if name == topics.VEHICLE_SCHEMA and self._topics[number] == topics.VEHICLE
        }
        self._findings = findings
        self._pool = pool
        self._waiting: deque[tuple[str, Future[bool]]] = deque()
        self._states = StatesWritten()
        self._pictures: dict[str, _Pictures] = defaultdict(_Pictures)
        self._last_row: dict[str, int] = {}
        self.counts: Counter[str] = Counter()
        self.pictures = 0

    def take(self, records: bytes, message: StoredMessage) -> None:
        topic = self._topics.get(message.channel)
        if topic is None:
            self._findings.append(Finding("messages of unknown channels", f"channel {message.channel}"))
            return
        self.counts[topic] += 1
        if topic in ROW_TOPICS:
            if message.sequence <= self._last_row.get(topic, -1):
                self._findings.append(Finding("rows out of order", f"{topic} row {message.sequence}"))
            self._last_row[topic] = message.sequence
        if message.channel in self._vehicle:
            try:
                state = VehicleState.FromString(records[message.offset : message.offset + message.length])
            except DecodeError:
                self._findings.append(Finding(_MISFIT, f"{topic} row {message.sequence}"))
            else:
                self._states.add(message.sequence, message.log_time_ns, state)
        elif message.channel in self._images:
            self._take_picture(topic, records, message)

    def _take_picture(self, topic: str, records: bytes, message: StoredMessage) -> None:
        at, length = image_data(records, message.offset, message.length)
        where = f"{topic} row {message.sequence}"
        if at < 0:
            self._findings.append(Finding(_MISFIT, where))
            return
        data = records[at : at + length]
        pictures = self._pictures[topic]
        pictures.keys.append((message.sequence, message.log_time_ns))
        pictures.is_repeated.append(data == pictures.last)
        pictures.last = data
        if self._pool is not None:
            self._waiting.append((where, self._pool.submit(_decodes, data)))
            self._settle(_MOST_WAITING)

    def _settle(self, most: int) -> None:
        """Wait until at most so many pictures are left to be decoded."""
        while len(self._waiting) > most:
            where, decoded = self._waiting.popleft()
            self.pictures += 1
            if not decoded.result():
                self._findings.append(Finding("pictures that do not decode", where))

    def judge(self) -> None:
        """What can only be said when everything was seen."""
        self._settle(0)
        states = self._states.states()
        keys = zip(states.row.tolist(), states.time_ns.tolist(), strict=True)
        speed_mph = dict(zip(keys, states.speed_mph.tolist(), strict=True))
        for topic, pictures in sorted(self._pictures.items()):
            if topic != topics.PILOT_INPUT:
                self._judge_pictures(topic, pictures, speed_mph)
        flags = row_flags(states)
        for flag, kind in _ROW_FINDINGS.items():
            for begin, end in stretches(flags[flag]):
                where = _rows(int(states.row[begin]), int(states.row[end]))
                self._findings.append(Finding(kind, f"before {where}" if flag == "gap" else where))

    def _judge_pictures(self, topic: str, pictures: _Pictures, speed_mph: dict[tuple[int, int], float]) -> None:
        seen = set(pictures.keys)
        for kind, keys in (
            ("rows without a picture", speed_mph.keys() - seen),
            ("pictures without a row", seen - speed_mph.keys() if speed_mph else set()),
        ):
            for first, last in _together(sorted({row for row, _ in keys})):
                self._findings.append(Finding(kind, f"{topic} {_rows(first, last)}"))
        # NaN, an unknown speed, is not below it
        moving = np.array([not speed_mph.get(key, np.nan) < STANDING_MPH for key in pictures.keys], np.bool_)
        repeated = np.array(pictures.is_repeated, np.bool_)
        for begin, end in stretches(repeated & moving):
            if end - begin + 2 >= FROZEN_PICTURES:
                where = _rows(pictures.keys[begin - 1][0], pictures.keys[end][0])
                self._findings.append(Finding("frozen pictures", f"{topic} {where}"))


def _decodes(data: bytes) -> bool:
    """At an eighth of the size: a fraction of the time, and the whole picture is still read through."""
    if not data:
        return False
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_REDUCED_GRAYSCALE_8) is not None
    except cv2.error:
        return False


def _rows(first: int, last: int) -> str:
    return f"row {first}" if first == last else f"rows {first} to {last}"


def _together(rows: list[int]) -> Iterator[tuple[int, int]]:
    """First and last of the runs of neighbouring numbers in a sorted list."""
    begin = 0
    for i in range(1, len(rows) + 1):
        if i == len(rows) or rows[i] > rows[i - 1] + 1:
            yield rows[begin], rows[i - 1]
            begin = i
