"""The topics of a log."""

from __future__ import annotations

from typing import Final

from common.car import CAMERAS, Camera

PROFILE: Final = "bc"
LIBRARY: Final = "behavioural-cloning-toolkit"  # what an MCAP file says that it was written by, before the version
SESSION_METADATA: Final = "bc.session"
QUALITY_METADATA: Final = "bc.quality"
DRIVE_METADATA: Final = "bc.drive"  # a drive's own summary

VEHICLE: Final = "/vehicle"
VEHICLE_SCHEMA: Final = "bc.VehicleState"
PILOT_INPUT: Final = "/pilot/input"
PILOT_COMMAND: Final = "/pilot/command"
PREDICTIONS: Final = "/prediction/"  # and the name of a run
EVENTS: Final = "/events"
POSE: Final = "/pose"


def camera_topic(camera: Camera) -> str:
    return f"/camera/{camera}"


def prediction_topic(run: str) -> str:
    """Where it is kept what the network of a run says of recorded pictures."""
    return f"{PREDICTIONS}{run}"


ROW_TOPICS: Final = frozenset(
    (
        *map(camera_topic, CAMERAS),
        VEHICLE,
        PILOT_INPUT,
        PILOT_COMMAND,
        POSE,
    )
)
"""Their messages carry their row's number as sequence number."""
