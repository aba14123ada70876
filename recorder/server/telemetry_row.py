"""Writes a telemetry as a log's row."""

from __future__ import annotations

from recorder.bc_pb2 import VehicleState
from recorder.log.writer import LogWriter, pose_message
from recorder.rows.devices import Device, device_value
from recorder.server.telemetry import Telemetry


def write_telemetry(
    writer: LogWriter,
    time_ns: int,
    row: int,
    telemetry: Telemetry,
    device: Device | None,
    *,
    brake: float = 0.0,
    not_recorded_s: float = 0.0,
    picture_size: tuple[int, int] | None = None,
    crop: bytes | None = None,
) -> None:
    """Write pictures, vehicle state and pose. `crop`: a PNG of the network's input."""
    if telemetry.picture:
        writer.picture("center", time_ns, row, telemetry.picture, picture_size)
    for camera, picture in telemetry.side_pictures.items():
        writer.picture(camera, time_ns, row, picture)
    if crop is not None:
        writer.crop(time_ns, row, crop)
    state = VehicleState(
        steering=telemetry.steering,
        throttle=telemetry.throttle,
        brake=brake,
        speed_mph=telemetry.speed_mph,
        device=device_value(device),
        not_recorded_s=not_recorded_s or None,
    )
    writer.vehicle(time_ns, row, state)
    pose = None if telemetry.world is None else telemetry.world.pose
    if pose is not None:
        writer.pose(time_ns, row, pose_message(pose, time_ns))
