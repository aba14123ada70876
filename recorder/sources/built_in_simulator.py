"""Records a simulated driver of the built-in simulator in a log, faster than real time."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

from common import Skipped, UserError
from common.errors import counted
from common.files import refuse_existing
from common.progress import progress_bar
from recorder.bc_pb2 import VehicleState
from recorder.errors import RecordingError
from recorder.log.meant_gaps import MeantGap
from recorder.log.session_car import BUILT_IN, metadata_of
from recorder.log.writer import LogWriter, pose_message
from recorder.sources.imported_rows import Imported
from recorder.sources.settings import SimulatedDrive
from recorder.topics import VEHICLE_COLUMNS
from simulator.driving.drive_limits import MAX_LAPS, MAX_SPEED_MPH, DriverName
from simulator.driving.person import make_driver
from simulator.driving.recovery_driving import MAX_RECOVERY, DriveStep, drive_for_recording, steps_each
from simulator.driving.simulation import Simulation
from simulator.protocol.udacity_writer import UdacityWriter
from simulator.rendering.camera import MOUNT_LEFT_M

# Simulated time has no date. This one makes the same drive the same log, byte for byte.
CLOCK_START_NS: Final = 1_767_225_600 * 10**9  # 2026-01-01T00:00:00Z

_LAPS_EXPECTED: Final = f"a number above 0 and up to {MAX_LAPS:,} (a lap takes some 70 MB)"
_SPEED_EXPECTED: Final = f"a set speed above 0 mph and up to {MAX_SPEED_MPH} (the car reaches 30)"
BACK_TO_START_S: Final = 2.0
"""The gap in a recording's times before the car drives from the start at another speed."""


def record_simulated(
    drive: SimulatedDrive, log: Path, *, udacity: Path | None = None, overwrite: bool = False
) -> Imported:
    """Record a drive to `log`, and to the folder `udacity`, if given, in the real simulator's format.

    Raises RecordingError for impossible settings, UserError if `log` exists and `overwrite` is off.
    """
    refuse_existing(log, overwrite)  # before the folder is created
    check_drive(drive)
    name, laps = drive.driver, drive.laps
    simulation = simulation_on(drive.track)
    metadata = simulator_metadata(
        simulation,
        name,
        laps=f"{laps:g}",
        speed=" ".join(f"{speed_mph:g}" for speed_mph in drive.speed),
        **{name: f"{getattr(drive, name):g}" for name in ("rate", "recovery", "noise")},
        seed=str(drive.seed),
    )
    length_m = len(drive.speed) * laps * simulation.track.line.length_m
    rows = put_back = 0
    last_s = 0.0
    with (
        UdacityWriter(udacity) if udacity is not None else contextlib.nullcontext() as folder,
        LogWriter(log, metadata, overwrite=overwrite) as writer,
        progress_bar() as bar,
    ):
        task = bar.add_task(f"recording {drive.track}", total=math.ceil(length_m), note="metres")
        for step, new_speed_mph in _drive_at_each_speed(simulation, drive, name, laps):
            time_ns = CLOCK_START_NS + round(step.time_s * 1e9)
            if new_speed_mph is not None and len(drive.speed) > 1:
                writer.event(time_ns, f"from the start, at a set speed of {new_speed_mph:g} mph")
            jpegs = {camera: simulation.jpeg(camera, step.pose) for camera in MOUNT_LEFT_M}
            for camera, jpeg in jpegs.items():
                writer.picture(camera, time_ns, rows, jpeg)
            driven = {column: getattr(step, column) for column in VEHICLE_COLUMNS}
            pause_s = step.time_s - last_s - 1 / drive.rate if rows else 0.0
            gap = MeantGap(pause_s, _why_not_recorded(step, new_speed_mph)) if pause_s > 1e-3 else None
            writer.vehicle(time_ns, rows, VehicleState(**driven), gap)
            last_s = step.time_s
            writer.pose(time_ns, rows, pose_message(step.pose, time_ns))
            if folder is not None:
                folder.row(time_ns, jpegs, **driven)
            rows += 1
            put_back += step.after_gap and not step.recovering
            bar.update(task, completed=step.progress_m)
        if not rows:
            raise UserError(f"{laps:g} laps: too short to record a single row")
        if folder is not None:
            folder.finish()
    notice = f"off the road {counted(put_back, 'time')}: the car was put back on its line, with a gap in the times"
    return Imported(log, rows, rows * len(MOUNT_LEFT_M), Skipped(), [notice] if put_back else [])


def simulation_on(track: str) -> Simulation:
    """The built-in simulator on a track. Raises RecordingError for an unknown track."""
    try:
        return Simulation(track)
    except ValueError as error:
        raise RecordingError(f"--track {track}: {error}") from None


def simulator_metadata(simulation: Simulation, driver: str, **drive: str) -> dict[str, str]:
    """The metadata of a log of the built-in simulator. `drive`: the settings of the drive."""
    return {
        "source": "simulator",
        "simulator": "built-in",
        "track": simulation.track.name,
        "track_fingerprint": simulation.track.fingerprint(),
        "driver": driver,
        **{f"drive.{name}": value for name, value in drive.items()},
        **metadata_of(BUILT_IN),
    }


def _why_not_recorded(step: DriveStep, new_speed_mph: float | None) -> str:
    if new_speed_mph is not None:
        return "the car was put back at the start"
    return f"the car was {'pushed off' if step.recovering else 'put back on'} its line"


def _drive_at_each_speed(
    simulation: Simulation, drive: SimulatedDrive, name: DriverName, laps: float
) -> Iterator[tuple[DriveStep, float | None]]:
    """The steps of a recording, with continuous times and progress. The first step at each speed comes with it."""
    begin_s = 0.0
    for number, speed_mph in enumerate(drive.speed):
        seed = drive.seed + number  # each drive has other pushes
        driver = make_driver(name, simulation.track.line, speed_mph, drive.noise, seed)
        begin_m = number * laps * simulation.track.line.length_m
        new_speed_mph: float | None = speed_mph
        for step in drive_for_recording(simulation.course, driver, laps, drive.rate, drive.recovery, seed):
            now_s = begin_s + step.time_s
            yield replace(step, time_s=now_s, progress_m=begin_m + step.progress_m), new_speed_mph
            new_speed_mph = None
        begin_s = now_s + BACK_TO_START_S


def check_drive(drive: SimulatedDrive) -> None:
    """Raise RecordingError, which names the flag, for impossible numbers."""
    try:
        steps_each(drive.rate)
    except ValueError as error:
        raise RecordingError(str(error)) from None
    if not drive.speed:
        raise RecordingError("--speed: expected a set speed in mph, or several")
    for flag, value, is_good, expected in (
        ("--laps", drive.laps, 0 < drive.laps <= MAX_LAPS, _LAPS_EXPECTED),
        *(("--speed", mph, 0 < mph <= MAX_SPEED_MPH, _SPEED_EXPECTED) for mph in drive.speed),
        ("--recovery", drive.recovery, 0 <= drive.recovery <= MAX_RECOVERY, f"a share of 0 .. {MAX_RECOVERY:g}"),
        ("--noise", drive.noise, 0 <= drive.noise < math.inf, "a standard deviation of the steering, 0 or more"),
        ("--seed", drive.seed, drive.seed >= 0, "a whole number from 0 on"),
    ):
        if not is_good:
            raise RecordingError(f"{flag} {value:g}: expected {expected}")
