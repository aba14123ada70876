"""The messages of a log with many small chunks are those that MCAP's own reader finds, with any content."""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import DecodeError, Message
from hypothesis import example, given
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


numbers = st.one_of(st.just(0.0), st.just(-0.0), st.floats(width=64))
states = st.tuples(numbers, numbers, numbers, numbers).map(
    lambda values: VehicleState(**dict[str, Any](zip(NAMES, values, strict=True))).SerializeToString()
)


@st.composite
def broken(draw: st.DrawFn) -> bytes:
    """A message with one byte changed, its end cut off, or another one behind it, which replaces its fields."""
    content = bytearray(draw(states) + draw(states) * draw(st.integers(0, 1)))
    if content and draw(st.booleans()):
        content[draw(st.integers(0, len(content) - 1))] = draw(st.integers(0, 255))
    return bytes(content[: draw(st.integers(0, len(content)))])


def one_by_one(contents: list[bytes]) -> bytes:
    """Bytes of the doubles: two that are no number are not equal."""
    rows = [[getattr(VehicleState.FromString(content), name) for content in contents] for name in NAMES]
    return b"".join(struct.pack("<d", value) for row in rows for value in row)


@given(st.lists(st.one_of(states, broken()), max_size=8))
@example([VehicleState(steering=1.0).SerializeToString()[:5]])
@example([VehicleState(steering=1.0).SerializeToString(), b"\x09"])
@example([b"", b"\x11" + bytes(8) + b"\x09" + bytes(8)])
def test_any_bytes_give_what_protobuf_makes_of_them(contents: list[bytes]) -> None:
    try:
        expected = one_by_one(contents)
    except DecodeError:
        with pytest.raises(DecodeError):
            decode_numbers(contents, VehicleState, NAMES)
    else:
        decoded = decode_numbers(contents, VehicleState, NAMES)
        assert decoded.shape == (4, len(contents))
        assert decoded.astype("<f8").tobytes() == expected


commands = st.builds(
    PilotCommand,
    predicted_steering=numbers,
    steering=numbers,
    driver=st.integers(-1, 200),
    total_ms=numbers,
    expert_steering=st.one_of(st.none(), numbers),
    in_flight=st.one_of(st.none(), st.integers(0, 300)),
).map(PilotCommand.SerializeToString)


@given(
    st.lists(
        st.tuples(commands, st.binary(max_size=2), st.integers(0, 2)).map(
            lambda a: a[0][: len(a[0]) - a[2]] + a[1]
        )
    )
)
@example([b"\x20"])
@example([b"\x20\x80\x01", b"\x20\x01\x20\x02"])
@example([b"\x20" + b"\xff" * 9 + b"\x01"])
def test_enums_and_fields_that_may_be_missing_are_those_of_protobuf(contents: list[bytes]) -> None:
    names = ("predicted_steering", "driver", "total_ms", "expert_steering", "in_flight")
    try:
        messages = [PilotCommand.FromString(content) for content in contents]
    except DecodeError:
        with pytest.raises(DecodeError):
            decode_numbers(contents, PilotCommand, names)
        return
    expected = [[getattr(message, name) for message in messages] for name in names[:3]]
    for name in names[3:]:
        expected.append(
            [float(getattr(message, name)) if message.HasField(name) else math.nan for message in messages]
        )
    assert np.array_equal(decode_numbers(contents, PilotCommand, names), np.array(expected), equal_nan=True)


POSE_NAMES = ("pose.position.x", "pose.orientation.w", "timestamp.nanos")


@st.composite
def poses(draw: st.DrawFn) -> bytes:
    """A pose, with one byte changed or its end cut off, or whole."""
    pose = PoseInFrame(frame_id=draw(st.sampled_from(["road", "", "Straße", "r" * 200])))
    pose.timestamp.seconds, pose.timestamp.nanos = draw(st.integers(-1, 2**40)), draw(st.integers(-1, 200))
    pose.pose.position.x, pose.pose.orientation.w = draw(numbers), draw(numbers)
    content = bytearray(pose.SerializeToString())
    if draw(st.booleans()):
        content[draw(st.integers(0, len(content) - 1))] = draw(st.integers(0, 255))
    return bytes(content[: len(content) - draw(st.sampled_from([0, 0, 0, 1, 9]))])


@given(st.lists(poses(), max_size=6))
def test_poses_are_those_of_protobuf(contents: list[bytes]) -> None:
    try:
        messages = [PoseInFrame.FromString(content) for content in contents]
    except DecodeError:
        with pytest.raises(DecodeError):
            decode_numbers(contents, PoseInFrame, POSE_NAMES)
        return
    expected = np.array([[attrgetter(name)(message) for message in messages] for name in POSE_NAMES], np.float64)
    decoded = decode_numbers(contents, PoseInFrame, POSE_NAMES)
    assert np.array_equal(decoded, expected.reshape(3, len(contents)), equal_nan=True)


def test_fields_are_given_in_the_order_that_is_asked_for() -> None:
    contents = [VehicleState(steering=0.5, speed_mph=row).SerializeToString() for row in range(3)]
    decoded = decode_numbers(contents, VehicleState, ("speed_mph", "steering"))
    assert decoded.tolist() == [[0, 1, 2], [0.5, 0.5, 0.5]]


def test_fields_of_fields_are_read_as_well() -> None:
    pose = PoseInFrame()
    pose.pose.position.x = 3.0
    assert decode_numbers([pose.SerializeToString()], PoseInFrame, ("pose.position.x",)).tolist() == [[3.0]]
    assert np.shape(decode_numbers([], VehicleState, NAMES)) == (4, 0)
