"""Driving: the pilot's decisions on the telemetry that the simulator tells, and the drive's log."""

from behavioural_cloning_toolkit import refuse_hidden

refuse_hidden(__name__)


from typing import TYPE_CHECKING

from common.lazy import lazy_names

if TYPE_CHECKING:
    from drive.closed_loop import Course, Result, evaluate
    from drive.config import DriveConfig
    from drive.driver import Decision, Driver
    from drive.errors import DriveError
    from drive.server import DriveServer
    from drive.speed import SpeedController

__all__ = [
    "Course",
    "Decision",
    "DriveConfig",
    "DriveError",
    "DriveServer",
    "Driver",
    "Result",
    "SpeedController",
    "evaluate",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Course": "drive.closed_loop",
        "Decision": "drive.driver",
        "DriveConfig": "drive.config",
        "DriveError": "drive.errors",
        "DriveServer": "drive.server",
        "Driver": "drive.driver",
        "Result": "drive.closed_loop",
        "SpeedController": "drive.speed",
        "evaluate": "drive.closed_loop",
    },
)
