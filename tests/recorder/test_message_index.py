"""The messages of a log with many small chunks are those that MCAP's own reader finds, with any content."""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import Message
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from numpy.typing import NDArray

from recorder import Log
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.mcap import message_index

like_a_message = st.builds(
    lambda length, rest: b"\x05" + struct.pack("<Q", length) + rest, st.integers(0, 300), st.binary(max_size=40)
)
contents = st.one_of(st.binary(max_size=60), like_a_message)
all_contents = st.lists(st.tuples(st.sampled_from("ab"), contents), max_size=60)


def mcap(messages: list[tuple[str, bytes]], chunk_bytes: int) -> bytes:
    """A file of MCAP's own writer, which registers a channel in the chunk of its first message."""
    file, channels = io.BytesIO(), dict[str, int]()
    writer = Writer(file, chunk_size=chunk_bytes)
    writer.start()
    for number, (topic, content) in enumerate(messages):
        if topic not in channels:
            channels[topic] = writer.register_channel(f"/{topic}", "raw", 0)
        writer.add_message(channels[topic], log_time=number, publish_time=0, sequence=number, data=content)
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("log") / "log.mcap"


@given(all_contents, st.sampled_from([1, 100, 1000]))
def test_the_messages_are_those_of_mcaps_reader(
    path: Path, messages: list[tuple[str, bytes]], chunk_bytes: int
) -> None:
    file = io.BytesIO(mcap(messages, chunk_bytes))
    path.write_bytes(file.getvalue())
    with Log(path) as log:
        for topic in ("/a", "/b"):
            file.seek(0)
            expected = [
                (message.sequence, message.log_time, message.data)
                for _, _, message in make_reader(file).iter_messages(topics=topic)
            ]
            found = [(place.sequence, place.log_time_ns, content) for place, content in log.contents(topic)]
            assert found == expected


NAMES = ("steering", "throttle", "brake", "speed_mph")


def decode_numbers(contents: Sequence[bytes], kind: type[Message], names: Sequence[str]) -> NDArray[np.float64]:
    """The numbers of messages with other bytes between them, as in a log."""
    ends = np.cumsum([3 + len(content) for content in contents], dtype=np.int64)
    starts = ends - [len(content) for content in contents]
    data = b"".join(b"\xff\x09\x11" + content for content in contents)
    return message_index.decode_numbers(data, starts.astype(np.int64), ends, kind, names)


def test_fields_are_given_in_the_order_that_is_asked_for() -> None:
    contents = [VehicleState(steering=0.5, speed_mph=row).SerializeToString() for row in range(3)]
    decoded = decode_numbers(contents, VehicleState, ("speed_mph", "steering"))
    assert decoded.tolist() == [[0, 1, 2], [0.5, 0.5, 0.5]]


def test_a_missing_optional_field_is_nan() -> None:
    contents = [command.SerializeToString() for command in (PilotCommand(expert_steering=0.5), PilotCommand())]
    decoded = decode_numbers(contents, PilotCommand, ("expert_steering", "steering"))
    assert np.array_equal(decoded, np.array([[0.5, math.nan], [0, 0]]), equal_nan=True)


def test_fields_of_fields_are_read_as_well() -> None:
    pose = PoseInFrame()
    pose.pose.position.x = 3.0
    assert decode_numbers([pose.SerializeToString()], PoseInFrame, ("pose.position.x",)).tolist() == [[3.0]]
    assert np.shape(decode_numbers([], VehicleState, NAMES)) == (4, 0)
