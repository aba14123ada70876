"""Logs of drives, as `bc-drive` writes them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.log.writer import LogWriter
from tests.helpers.logs import START_NS, STEP_NS

EXPERT: dict[int, dict[str, Any]] = {row: {"expert_steering": 0.1 - 0.2 * (row - 5)} for row in range(5, 10)}
"""From the sixth row on, an expert is there, who would steer 0, 5, 10, 15 and 20 degrees more to the left."""


def a_drive(path: Path, run: str, picture: Callable[[int], bytes] | None = None, **session: str) -> None:
    """Ten rows eastwards; after the fifth one the car was put back."""
    with LogWriter(path, {"source": "drive", "run": run} | session) as writer:
        for row in range(10):
            now_ns = START_NS + row * STEP_NS
            pose = PoseInFrame()
            pose.pose.position.x = 10.0 * row
            writer.pose(now_ns, row, pose)
            if picture:
                writer.picture("center", now_ns, row, picture(row))
            if row == 5:
                writer.event(now_ns, "off the road, or stuck: the simulator put the car back", name="drive")
            writer.vehicle(now_ns, row, VehicleState(steering=0.1, throttle=0.5, brake=0.0, speed_mph=9.0))
            writer.command(
                now_ns, row, PilotCommand(driver=PilotCommand.PILOT, steering=0.1, **EXPERT.get(row, {}))
            )
        writer.add_metadata("bc.drive", {"laps": "0.25", "autonomy_percent": "87.5", "interventions": "1"})
