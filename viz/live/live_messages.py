"""Turn new messages of a growing log into the same entities and curves that playback makes of a whole log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import rerun as rr
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.message import Message as ProtobufMessage

from recorder.topics import EVENTS, PICTURE_TOPICS, TOPICS
from viz.playback.blueprint import CENTER, log_layout
from viz.playback.curves import Drawing, frame_size
from viz.playback.log_chunks import picture_columns
from viz.timelines import Times, log_clock

SHOWN: Final[Mapping[str, type[ProtobufMessage]]] = {name: topic.message.load() for name, topic in TOPICS.items()}
"""The shown topics, and the types of their messages."""


@dataclass(frozen=True)
class LiveMessage:
    """A message to show. `content` has the type of `SHOWN` for its topic."""

    topic: str
    row: int
    log_time_ns: int
    content: Any


class LiveMessageSender:
    """Sends messages to a recording. If it is watched, it gets a new layout when a new topic appears; else it gets
    one layout, from `finish`."""

    def __init__(self, recording: rr.RecordingStream, *, is_watched: bool) -> None:
        self._recording = recording
        self._is_watched = is_watched
        self._start_ns: int | None = None
        self._drawing = Drawing(recording, self._clock)
        self._topics: set[str] = set()
        self._laid_out: set[str] = set()
        self._has_size = False

    def send(self, messages: Sequence[LiveMessage]) -> None:
        if self._start_ns is None:
            self._start_ns = min((message.log_time_ns for message in messages), default=None)
        by_topic: dict[str, list[LiveMessage]] = {}
        for message in messages:
            by_topic.setdefault(message.topic, []).append(message)
        self._topics |= by_topic.keys()
        # pictures come first; their other topics come within a second
        if self._is_watched and not self._topics <= PICTURE_TOPICS:
            self._lay_out()
        for topic in sorted(by_topic, key=lambda topic: topic not in PICTURE_TOPICS):
            topic_messages = by_topic[topic]
            time_ns = np.array([message.log_time_ns for message in topic_messages], np.int64)
            contents = [message.content for message in topic_messages]
            if TOPICS[topic].is_picture:
                self._send_pictures(topic, time_ns, contents)
            else:
                self._drawing.send(topic, time_ns, contents)

    def finish(self) -> None:
        """Send the layout if it has changed, and the drawings of all messages until now: histogram and path. Call
        it at the end; if the recording is watched, also from time to time."""
        self._lay_out()
        self._drawing.finish()

    def _clock(self, time_ns: Times) -> list[rr.TimeColumn]:
        return log_clock(self._start_ns or 0)(time_ns)

    def _lay_out(self) -> None:
        new = self._topics - self._laid_out
        if new - {EVENTS} or (new and not self._laid_out):
            # A late first event must not reset the user's changes of the layout: the layout always has events.
            self._recording.send_blueprint(log_layout({*self._topics, EVENTS}, grows=True))
            self._laid_out |= new

    def _send_pictures(self, topic: str, time_ns: Times, pictures: list[CompressedImage]) -> None:
        if topic == CENTER and not self._has_size:
            self._has_size = True
            self._drawing.picture_size = frame_size(pictures[0].data) or self._drawing.picture_size
        columns = picture_columns([picture.data for picture in pictures], [picture.format for picture in pictures])
        self._recording.send_columns(topic, self._clock(time_ns), columns)
