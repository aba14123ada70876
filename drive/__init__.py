"""Driving: the network's command for each telemetry message, the log of the drive, and closed-loop evaluation."""

from typing import TYPE_CHECKING

from common.lazy import lazy_names

if TYPE_CHECKING:
    from drive.config import DriveConfig as DriveConfig
    from drive.config import DriveError as DriveError
    from drive.control.driver import Decision as Decision
    from drive.control.driver import Driver as Driver
    from drive.control.speed_controller import SpeedController as SpeedController
    from drive.drive_server import DriveServer as DriveServer
    from drive.evaluation.closed_loop import BuiltInSimulator as BuiltInSimulator
    from drive.evaluation.closed_loop import DriveResult as DriveResult
    from drive.evaluation.closed_loop import evaluate as evaluate

_HOMES = {
    "BuiltInSimulator": "drive.evaluation.closed_loop",
    "Decision": "drive.control.driver",
    "DriveConfig": "drive.config",
    "DriveError": "drive.config",
    "DriveResult": "drive.evaluation.closed_loop",
    "DriveServer": "drive.drive_server",
    "Driver": "drive.control.driver",
    "SpeedController": "drive.control.speed_controller",
    "evaluate": "drive.evaluation.closed_loop",
}
__all__ = [*_HOMES]
__getattr__, __dir__ = lazy_names(__name__, _HOMES)
