"""Driving: the server that the simulator connects to, the pilot's decisions, and the drive's log."""

import warnings

with warnings.catch_warnings():
    # The user asked for eventlet, which announces its own retirement to everyone who starts a drive.
    warnings.filterwarnings("ignore", message=r"\s*Eventlet is deprecated")
    import eventlet.greenio  # noqa: F401

from drive.driver import Decision, Driver
from drive.errors import DriveError
from drive.server import DriveServer, open_log
from drive.speed import SpeedController
from drive.telemetry import Telemetry, TelemetryError, parse_telemetry

__all__ = [
    "Decision",
    "DriveError",
    "DriveServer",
    "Driver",
    "SpeedController",
    "Telemetry",
    "TelemetryError",
    "open_log",
    "parse_telemetry",
]
