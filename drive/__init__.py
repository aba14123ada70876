"""Driving: the server that the simulator connects to, the pilot's decisions, and the drive's log."""

from typing import TYPE_CHECKING

from common.lazy import lazy_names

if TYPE_CHECKING:
    from drive.closed_loop import Course, Result, evaluate
    from drive.driver import Decision, Driver
    from drive.errors import DriveError
    from drive.server import DriveServer, open_log
    from drive.speed import SpeedController
    from drive.telemetry import Telemetry, TelemetryError, parse_telemetry

__all__ = [
    "Course",
    "Decision",
    "DriveError",
    "DriveServer",
    "Driver",
    "Result",
    "SpeedController",
    "Telemetry",
    "TelemetryError",
    "evaluate",
    "open_log",
    "parse_telemetry",
]

__getattr__ = lazy_names(
    __name__,
    {
        "Course": "drive.closed_loop",
        "Decision": "drive.driver",
        "DriveError": "drive.errors",
        "DriveServer": "drive.server",
        "Driver": "drive.driver",
        "Result": "drive.closed_loop",
        "SpeedController": "drive.speed",
        "Telemetry": "drive.telemetry",
        "TelemetryError": "drive.telemetry",
        "evaluate": "drive.closed_loop",
        "open_log": "drive.server",
        "parse_telemetry": "drive.telemetry",
    },
)
