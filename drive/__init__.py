"""Driving: the pilot's decisions on the telemetry that the simulator tells, and the drive's log."""

from behavioural_cloning_toolkit import refuse_hidden

refuse_hidden(__name__)


from typing import TYPE_CHECKING

from common.lazy import lazy_names

if TYPE_CHECKING:
    from drive.config import DriveConfig
    from drive.control.driver import Decision, Driver
    from drive.control.speed_controller import SpeedController
    from drive.errors import DriveError
    from drive.evaluation.closed_loop import Course, Result, evaluate
    from drive.server import DriveServer

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
        "Course": "drive.evaluation.closed_loop",
        "Decision": "drive.control.driver",
        "DriveConfig": "drive.config",
        "DriveError": "drive.errors",
        "DriveServer": "drive.server",
        "Driver": "drive.control.driver",
        "Result": "drive.evaluation.closed_loop",
        "SpeedController": "drive.control.speed_controller",
        "evaluate": "drive.evaluation.closed_loop",
    },
)
