"""The numbers of a log's messages, as arrays."""

from __future__ import annotations

import numpy as np
import pytest
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import DecodeError, Message

from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.mcap.number_fields import decode_numbers


def decoded(messages: list[Message], names: list[str]) -> np.ndarray:
    """Of messages with other bytes between them, as in a log."""
    contents = [message.SerializeToString() for message in messages]
    ends = np.cumsum([3 + len(content) for content in contents]).astype(np.int64)
    starts = ends - np.array([len(content) for content in contents])
    data = b"".join(b"\xff\x09\x11" + content for content in contents)
    return decode_numbers(data, starts, ends, type(messages[0]), names)


def test_a_missing_optional_number_is_none_and_another_is_0() -> None:
    messages: list[Message] = [PilotCommand(steering=-0.5, expert_steering=0.25, in_flight=3), PilotCommand()]
    found = decoded(messages, ["steering", "driver", "expert_steering", "in_flight"])
    expected = np.array([[-0.5, 0], [0, 0], [0.25, np.nan], [3, np.nan]])
    assert np.array_equal(found, expected, equal_nan=True)


def test_fields_of_fields_are_read() -> None:
    pose = PoseInFrame(frame_id="world")
    pose.pose.position.x, pose.timestamp.nanos = 1.5, 7
    found = decoded([pose, PoseInFrame()], ["pose.position.x", "pose.orientation.w", "timestamp.nanos"])
    assert found.tolist() == [[1.5, 0], [0, 0], [7, 0]]


def test_other_bytes_are_an_error() -> None:
    with pytest.raises(DecodeError):
        decode_numbers(b"\x09", np.array([0]), np.array([1]), VehicleState, ["steering"])
