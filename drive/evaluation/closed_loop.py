"""Driving the built-in simulator: it runs as a process of its own and connects over the real wire."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from common.files import refuse_existing
from common.interrupts import StopEvent, stop_signals
from drive.config import DriveConfig
from drive.errors import DriveError
from drive.log.summary import DriveSummary
from drive.server import DriveServer
from model import Pilot
from recorder.server.telemetry_server import ServerMode
from simulator.roads.track import load_track

SIMULATOR_METADATA: Final = "bc.simulator"
"""The metadata record of a log that holds the simulator's own book of the drive."""


END_S: Final = 10.0
"""How long a simulator that is told to end may take."""


@dataclass(frozen=True)
class Course:
    """What to drive: a track (lake, mountain, random:SEED), and how far."""

    track: str
    laps: float = 1.0
    real_time: bool = False
    """No faster than the clock; otherwise simulated time waits for each answer, and hurries."""

    def __post_init__(self) -> None:
        """Raises DriveError for a course that nobody can drive."""
        check_laps(self.laps)
        try:
            load_track(self.track)
        except ValueError as error:
            raise DriveError(f"--simulator {self.track}: {error}") from None

    @property
    def name(self) -> str:
        """What logs and runs are called after it."""
        return self.track.replace(":", "-")

    @property
    def flags(self) -> tuple[str, ...]:
        """What of a command line chooses it."""
        return "--simulator", self.track

    @property
    def where(self) -> str:
        return self.track

    def drive(self, pilot: Pilot, config: DriveConfig, log: Path, mode: ServerMode) -> DriveSummary:
        """As `drive_course`: what the log says in the end."""
        return drive_course(pilot, self, config, log, mode=mode)[1]


def check_laps(laps: float) -> None:
    """Raises DriveError for what nobody can drive."""
    if not 0 < laps < math.inf:
        raise DriveError(f"--laps {laps:g}: how far to drive is a number above 0")


@dataclass(frozen=True)
class Result:
    """How a drive went: the simulator's own book (`simulator.protocol.autonomous_mode.Driven`), and its log."""

    course: Course
    config: DriveConfig
    log: Path
    book: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        return {"set_speed_mph": self.config.set_speed_mph, "log": str(self.log), **self.book}


def evaluate(
    pilot: Pilot,
    drives: Sequence[tuple[Course, DriveConfig]],
    logs: Path,
    *,
    overwrite: bool = False,
    said: Callable[[str], None] = lambda text: None,
) -> Iterator[Result]:
    """Drive every course in lock-step, log each, and give the results as they come.

    Raises DriveError where the simulator fails, UserError where a log exists and may not be overwritten.
    """
    paths = [_log_path(pilot, course, config, logs) for course, config in drives]
    for path in paths:  # before the first drive, not after it
        refuse_existing(path, overwrite)
    if len(set(paths)) < len(paths):
        raise DriveError("the same track at the same speed is named twice")
    for (course, config), path in zip(drives, paths, strict=True):
        laps = f"{course.laps:g} lap{'' if course.laps == 1 else 's'}"
        said(f"{pilot.run} on {course.track} at {config.set_speed_mph:g} mph, {laps}")
        book, _ = drive_course(pilot, course, config, path, overwrite=overwrite)
        yield Result(course, config, path, book)


def _log_path(pilot: Pilot, course: Course, config: DriveConfig, logs: Path) -> Path:
    return logs / f"{pilot.run}-{course.name}-{config.set_speed_mph:g}mph.mcap"


def drive_course(
    pilot: Pilot,
    course: Course,
    config: DriveConfig,
    log: Path,
    *,
    overwrite: bool = False,
    mode: ServerMode = "eventlet",
) -> tuple[dict[str, Any], DriveSummary]:
    """Drive a course in lock-step, and log it: the simulator's book, and what the drive's own log says in the end.

    Raises DriveError if the simulator fails, KeyboardInterrupt if it was stopped; the log is finished then too.
    """
    with (
        stop_signals() as stopped,
        DriveServer(pilot, config, log, overwrite=overwrite, port=0, mode=mode, is_built_in=True) as server,
    ):
        book = drive_built_in(server, course, stopped)
        if not book:
            raise KeyboardInterrupt
        return book, server.session.summary


def drive_built_in(
    server: DriveServer, course: Course, stopped: StopEvent, *, shows_progress: bool = True
) -> dict[str, Any]:
    """Serve until the built-in simulator has driven its course or `stopped` is set; the simulator's book, which is
    kept in the log too, empty if it was stopped. Raises DriveError if the simulator fails.

    Without `shows_progress`, the simulator draws no bar on the terminal.
    """
    with _simulator(server, course, shows_progress=shows_progress) as process:
        server.run(until=lambda: process.poll() is not None, stopped=stopped)
        if process.poll() is None:
            return {}
        output, said = process.communicate()
        if process.returncode != 0:
            why = (said or b"").decode(errors="replace").strip().rpartition("\n")[2]
            code = f"the simulator on {course.track} ended with exit code {process.returncode}"
            raise DriveError(f"{code}: {why}" if why else code)
        book: dict[str, Any] = json.loads(output)
        if book["gave_up"] and not shows_progress:  # else the simulator has said so itself
            server.say("the car did not get on for a minute: given up")
        server.session.note(SIMULATOR_METADATA, {name: str(value) for name, value in book.items()})
        return book


@contextmanager
def _simulator(server: DriveServer, course: Course, *, shows_progress: bool) -> Iterator[subprocess.Popen[bytes]]:
    config = server.config
    command = [
        *(sys.executable, "-P", "-m", "simulator.cli", "--json", "--tell-world", "--port", str(server.port)),
        *("--track", course.track, "--laps", str(course.laps), "--expert-speed", str(config.set_speed_mph)),
        *(["--leave-off-road"] if config.takeover else []),  # the expert brings the car back himself
        *(["--real-time"] if course.real_time else []),
    ]
    # In a session of its own: Ctrl-C reaches only us, and the drive ends between two telemetries.
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=None if shows_progress else subprocess.PIPE,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
