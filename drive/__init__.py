"""Driving: the network's command for each telemetry of a simulator, the drive's log, and closed-loop
evaluation."""

from behavioural_cloning_toolkit import refuse_hidden

refuse_hidden(__name__)


from typing import TYPE_CHECKING

from common.lazy import lazy_names

if TYPE_CHECKING:
    from drive.config import DriveConfig
    from drive.control.driver import Decision, Driver
    from drive.control.speed_controller import SpeedController
    from drive.drive_server import DriveServer
    from drive.errors import DriveError
    from drive.evaluation.closed_loop import DriveResult, evaluate
    from drive.evaluation.simulator_process import BuiltInSimulator

__all__ = [
    "BuiltInSimulator",
    "Decision",
    "DriveConfig",
    "DriveError",
    "DriveResult",
    "DriveServer",
    "Driver",
    "SpeedController",
    "evaluate",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "BuiltInSimulator": "drive.evaluation.simulator_process",
        "Decision": "drive.control.driver",
        "DriveConfig": "drive.config",
        "DriveError": "drive.errors",
        "DriveResult": "drive.evaluation.closed_loop",
        "DriveServer": "drive.drive_server",
        "Driver": "drive.control.driver",
        "SpeedController": "drive.control.speed_controller",
        "evaluate": "drive.evaluation.closed_loop",
    },
)
