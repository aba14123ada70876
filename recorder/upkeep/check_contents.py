"""Checks the messages of a log: pictures, rows, and how they fit together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from concurrent.futures import Executor
from typing import Final, NamedTuple, TypeVar

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log as LogMessage
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import DecodeError, Message

from common.location import Location
from common.stretches import consecutive
from recorder import topics
from recorder.bc_pb2 import VehicleState
from recorder.log.findings import WrittenRows
from recorder.log.meant_gaps import read_event
from recorder.log.tags import TaggedRows
from recorder.mcap.compressed_image import image_data
from recorder.mcap.mcap_file import StoredMessage
from recorder.mcap.message_index import LAST_TIME_NS
from recorder.mcap.scan import Structure
from recorder.pictures.image_check import ImageCheck, TopicPictures
from recorder.pictures.picture_size import PictureSizes, width_and_height
from recorder.rows.causes import CAUSES
from recorder.rows.odd_stretches import OddStretch, odd_stretches, rows_named
from recorder.rows.row_quality import STANDING_MPH

Content = TypeVar("Content", bound=Message)

GAPS: Final = "gaps in time"
MAX_STILL: Final = 0.1
"""The share of rows with the time of the row before, above which a clock is too coarse, such as whole seconds."""
MISFIT: Final = "messages that do not match their schema"


class Finding(NamedTuple):
    kind: str
    where: str


class Contents:
    """Collects findings from messages, added one by one in the log's order."""

    def __init__(
        self,
        structure: Structure,
        findings: list[Finding],
        pool: Executor | None,
        path: Location,
        *,
        is_ours: bool,
        fine: TaggedRows,
    ) -> None:
        self._is_ours = is_ours
        self._fine = fine
        self._topics = {number: channel.topic for number, channel in structure.channels.items()}
        self._images = structure.image_channels

        def channels(topic: str) -> set[int]:
            schema = topics.TOPICS[topic].message.name
            numbers = {number for number, name in self._topics.items() if name == topic}
            return {number for number in numbers if structure.is_protobuf(number, schema)}

        self._vehicle, self._events, self._poses = map(channels, (topics.VEHICLE, topics.EVENTS, topics.POSE))
        in_order = {name for name, topic in topics.TOPICS.items() if topic.is_in_order}
        self._in_order = {number for number, topic in self._topics.items() if topic in in_order}
        self._bad_telemetry: Counter[str] = Counter()
        self._findings = findings
        self._image_check = ImageCheck(pool)
        self._rows = WrittenRows(None, path)
        self._last_row: dict[str, int] = {}
        self._sizes = PictureSizes()
        self.counts: Counter[str] = Counter()
        self.meant_gaps: list[str] = []  # the rows after them
        self.set_back: list[str] = []  # the gaps at which time goes back
        self.odd: list[OddStretch] = []

    @property
    def pictures(self) -> int:
        return self._image_check.decoded

    def add(self, records: bytes, message: StoredMessage) -> None:
        topic = self._topics.get(message.channel)
        if topic is None:
            self._findings.append(Finding("messages of unknown channels", f"channel {message.channel}"))
            return
        self.counts[topic] += 1
        if message.log_time_ns > LAST_TIME_NS:
            self._findings.append(Finding("impossible times", f"{topic} row {message.sequence}"))
            return
        if message.channel in self._in_order:
            if message.sequence <= self._last_row.get(topic, -1):
                self._findings.append(Finding("rows out of order", f"{topic} row {message.sequence}"))
            self._last_row[topic] = message.sequence
        if message.channel in self._vehicle:
            state = self._decoded(VehicleState, topic, records, message)
            if state is not None:
                self._rows.add(message.sequence, message.log_time_ns, state)
        elif message.channel in self._images:
            self._add_picture(topic, records, message)
        elif message.channel in self._events:
            self._add_event(topic, records, message)
        elif message.channel in self._poses:
            self._decoded(PoseInFrame, topic, records, message)

    def _decoded(self, kind: type[Content], topic: str, records: bytes, message: StoredMessage) -> Content | None:
        """The content of a message; None, with a finding, if it is of another kind."""
        try:
            return kind.FromString(records[message.offset : message.offset + message.length])
        except DecodeError:
            self._findings.append(Finding(MISFIT, f"{topic} row {message.sequence}"))
            return None

    def _add_picture(self, topic: str, records: bytes, message: StoredMessage) -> None:
        at, length = image_data(records, message.offset, message.length)
        if at < 0:
            self._findings.append(Finding(MISFIT, f"{topic} row {message.sequence}"))
            return
        picture = records[at : at + length]
        self._sizes.add(topic, message.sequence, width_and_height(picture))
        self._image_check.add(topic, message.sequence, message.log_time_ns, picture)

    def _add_event(self, topic: str, records: bytes, message: StoredMessage) -> None:
        event = self._decoded(LogMessage, topic, records, message)
        if event is None:
            return
        kind, count = read_event(event.message)
        if count:
            self._bad_telemetry[kind] += count
        self._rows.add_event(message.log_time_ns, event.message)

    def finish(self) -> None:
        """Add the findings that need all messages."""
        self._image_check.finish()
        for topic, at in self._image_check.broken:
            where = f"{topic} row {self._image_check.pictures[topic].rows[at]}"
            self._findings.append(Finding("pictures that do not decode", where))
        for reason, count in self._bad_telemetry.most_common():
            self._findings.append(Finding("kinds of unusable telemetry", f"{reason} ({count:,})"))
        for topic, sizes in self._sizes.mixed().items():
            self._findings.append(Finding("cameras with pictures of several sizes", f"{topic}: {sizes}"))
        states = self._rows.states()
        keys = zip(states.row.tolist(), states.time_ns.tolist(), strict=True)
        speed_mph = dict(zip(keys, states.speed_mph.tolist(), strict=True))
        for topic in sorted(self._cameras(has_rows=bool(speed_mph))):
            self._check_pictures(topic, self._image_check.pictures.get(topic, TopicPictures()), speed_mph)
        meant = self._rows.meant_gaps(states)
        self.meant_gaps = [f"before row {row}" for row in states.row[meant].tolist()]
        for at in np.flatnonzero(states.flags["gap"] & ~meant).tolist():
            row = int(states.row[at])
            if not self._fine.cover(row, row):
                self._findings.append(Finding(GAPS, f"before row {row}"))
                if states.time_ns[at] < states.time_ns[at - 1]:
                    self.set_back.append(f"before row {row}")
        still = states.row[1:][np.diff(states.time_ns) == 0].tolist()
        if len(still) > MAX_STILL * len(states.row):
            for first, last in consecutive(still):
                self._findings.append(Finding("stretches of rows at the same time", rows_named(first - 1, last)))
        self.odd = odd_stretches(states)

    def _cameras(self, *, has_rows: bool) -> frozenset[str]:
        """The topics on which every row should have a picture, also of a camera without any."""
        recorded = topics.CAMERA_TOPICS.intersection(self._topics.values())
        expected = {topics.camera_topic("center")} if has_rows else set()
        others = topics.PICTURE_TOPICS - topics.CAMERA_TOPICS
        return (recorded | expected | self._image_check.pictures.keys()) - others

    def _check_pictures(
        self, topic: str, pictures: TopicPictures, speed_mph: dict[tuple[int, int], float]
    ) -> None:
        with_picture = set(zip(pictures.rows, pictures.times_ns, strict=True))
        expects_rows = self._is_ours or bool(speed_mph)  # other programs' logs may have none
        for kind, keys in (
            ("stretches of rows without a picture", speed_mph.keys() - with_picture),
            ("stretches of pictures without a row", with_picture - speed_mph.keys() if expects_rows else set()),
        ):
            for first, last in consecutive(sorted({row for row, _ in keys})):
                self._findings.append(Finding(kind, f"{topic} {rows_named(first, last)}"))
        standing = {key for key, speed in speed_mph.items() if speed < STANDING_MPH}  # False for NaN
        for first, last in pictures.frozen(standing):
            rows = (pictures.rows[first], pictures.rows[last])
            if not self._fine.cover(*rows):
                self._findings.append(Finding("stretches of frozen pictures", f"{topic} {rows_named(*rows)}"))


def odd_findings(odd: Iterable[OddStretch]) -> list[Finding]:
    """The findings among odd stretches."""
    return [
        Finding(CAUSES[stretch.kind].several, rows_named(stretch.first_row, stretch.last_row))
        for stretch in odd
        if CAUSES[stretch.kind].several
    ]
