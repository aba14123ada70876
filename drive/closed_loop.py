"""Driving the built-in simulator: it runs as a process of its own and connects over the real wire."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common.files import refuse_existing
from common.interrupts import stop_signals
from drive.errors import DriveError
from drive.server import DriveServer, open_log
from drive.speed import check_set_speed
from model import Pilot
from simulator.track import load_track


@dataclass(frozen=True)
class Course:
    """What to drive: a track (lake, mountain, random:SEED), how far, and how fast."""

    track: str
    laps: float = 1.0
    set_speed_mph: float = 10.0

    def __post_init__(self) -> None:
        """Raises DriveError for a course that nobody can drive."""
        check_set_speed(self.set_speed_mph)
        if not 0 < self.laps < math.inf:
            raise DriveError(f"--laps {self.laps:g}: how far to drive is a number above 0")
        try:
            load_track(self.track)
        except ValueError as error:
            raise DriveError(str(error)) from None


@dataclass(frozen=True)
class Result:
    """How a drive went: the simulator's own book (see `simulator.autonomous.Driven`), and its log."""

    course: Course
    log: Path
    book: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        return {"set_speed_mph": self.course.set_speed_mph, "log": str(self.log), **self.book}


def evaluate(
    pilot: Pilot,
    courses: Sequence[Course],
    logs: Path,
    *,
    overwrite: bool = False,
    said: Callable[[str], None] = lambda text: None,
) -> Iterator[Result]:
    """Drive every course in lock-step, log each, and give the results as they come.

    Raises DriveError where the simulator fails, UserError where a log exists and may not be overwritten.
    """
    paths = [_log_path(pilot, course, logs) for course in courses]
    for path in paths:  # before the first drive, not after it
        refuse_existing(path, overwrite)
    if len(set(paths)) < len(paths):
        raise DriveError("the same track at the same speed is named twice")
    for course, path in zip(courses, paths, strict=True):
        said(f"{pilot.run} on {course.track} at {course.set_speed_mph:g} mph, {course.laps:g} laps")
        with (
            stop_signals() as stopped,
            open_log(path, pilot, course.set_speed_mph, overwrite=overwrite) as log,
        ):
            server = DriveServer(pilot, log, port=0, set_speed_mph=course.set_speed_mph)
            book = drive_built_in(server, course, stopped)
            if not book:
                raise KeyboardInterrupt
            log.add_metadata("bc.drive", {name: str(value) for name, value in book.items()})
        yield Result(course, path, book)


def _log_path(pilot: Pilot, course: Course, logs: Path) -> Path:
    return logs / f"{pilot.run}-{course.track.replace(':', '-')}-{course.set_speed_mph:g}mph.mcap"


def drive_built_in(server: DriveServer, course: Course, stopped: threading.Event) -> dict[str, Any]:
    """Serve until the built-in simulator has driven its course or `stopped` is set; the simulator's book, empty
    if it was stopped. Raises DriveError if the simulator fails."""
    with _simulator(course, server.port) as process:
        server.run(until=lambda: stopped.is_set() or process.poll() is not None)
        if process.poll() is None:
            return {}
        output, _ = process.communicate()
        if process.returncode != 0:
            raise DriveError(f"the simulator on {course.track} ended with exit code {process.returncode}")
        book: dict[str, Any] = json.loads(output)
        return book


@contextmanager
def _simulator(course: Course, port: int) -> Iterator[subprocess.Popen[bytes]]:
    command = [
        *(sys.executable, "-m", "simulator.cli", "--json", "--port", str(port)),
        *("--track", course.track, "--laps", str(course.laps)),
    ]
    # In a session of its own: Ctrl-C reaches only us, and the drive ends between two telemetries.
    process = subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True)
    try:
        yield process
    finally:
        process.terminate()
        process.wait()
