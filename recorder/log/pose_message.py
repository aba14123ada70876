"""The car's pose as a Foxglove message."""

from __future__ import annotations

import math

from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

from recorder.log.writer import timestamp
from simulator.pose import Pose


def pose_message(pose: Pose, time_ns: int) -> PoseInFrame:
    """Metres, x east, y north, z up; attitude a quaternion (yaw, pitch, roll)."""
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
