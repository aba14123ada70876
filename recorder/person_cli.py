"""`bc-record --driver me`: a person drives the built-in simulator, or one that connects."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from common.command import flags_given, usage_errors
from common.errors import UsageError
from common.wheel_page import check_wheel_page, wait_until_left, wheel_page
from recorder.errors import RecordingError
from recorder.sources.frame_rate import check_row_rate
from recorder.sources.imported_rows import Imported
from recorder.sources.settings import ListenSettings, SimulatedDrive
from simulator.driving.drive_limits import MAX_SPEED_MPH

if TYPE_CHECKING:
    from recorder.teleop.wheel import Wheel


def record_at_the_wheel(
    drive: SimulatedDrive,
    rate: float | None,
    log: Path,
    listens: ListenSettings | None,
    *,
    opens: bool,
    serves: bool,
    overwrite: bool,
) -> Imported:
    """Record a person in the built-in simulator, or, with `listens`, in one that connects. `serves`: serve the
    page to drive on (otherwise, a running bc-web has it). `opens`: open the browser."""
    if serves:
        check_wheel_page()
    with ExitStack() as stack:

        def serve_page(wheel: Wheel) -> None:
            if serves:
                stack.enter_context(wheel_page(wheel.key, {"sessions": log.parent}, opens=opens))

        if listens is not None:
            from recorder.sources.person_of_telemetry import listen_at_the_wheel  # Socket.IO: a second to load

            done = listen_at_the_wheel(listens, log, drive.speed[0], overwrite=overwrite, on_wheel=serve_page)
        else:
            from recorder.sources.record_person import record_person  # OpenCV

            done = record_person(_at_rate(drive, rate), log, overwrite=overwrite, on_wheel=serve_page)
        if serves:
            wait_until_left(done.path)
        return done


def check_at_the_wheel(drive: SimulatedDrive, rate: float | None, *, listens: bool) -> None:
    """Raise UsageError for flags that do not fit a person's drive."""
    if flags := flags_given(drive, "recovery", "noise", "seed"):
        raise UsageError(f"{flags}: only for a simulated driver, not with --driver me")
    if len(drive.speed) != 1 or not 0 < drive.speed[0] <= MAX_SPEED_MPH:
        raise UsageError(
            f"--speed: with --driver me, give the one speed that the page holds, above 0 mph and up to"
            f" {MAX_SPEED_MPH}"
        )
    if listens:
        if flags := flags_given(drive, "track", "laps", "start") or ("--rate" if rate is not None else ""):
            raise UsageError(f"{flags}: the simulator that connects decides; not with --listen --driver me")
        return
    with usage_errors(RecordingError):
        check_row_rate(_at_rate(drive, rate).rate)
    if not 0 <= drive.start < math.inf:
        raise UsageError(f"--start {drive.start:g}: a number of metres, 0 or more, was expected")
    if drive.laps is not None and not 0 < drive.laps < math.inf:
        raise UsageError(f"--laps {drive.laps:g}: a number above 0 was expected")


def _at_rate(drive: SimulatedDrive, rate: float | None) -> SimulatedDrive:
    return drive if rate is None else replace(drive, rate=rate)
