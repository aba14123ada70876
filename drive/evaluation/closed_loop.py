"""Closed-loop evaluation: a network drives the built-in simulator, a process of its own, on several tracks."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from common.files import refuse_existing
from common.interrupts import StopEvent, stop_signals
from common.tasks import Tasks, report_share
from drive.config import DriveConfig, DriveError
from drive.drive_server import DriveServer
from model import Pilot, load_pilot
from model.config import Device, Precision
from model.network.own_code import load_code
from model.runs.run_folder import run_name
from simulator.driving.drive_limits import MAX_LAPS
from simulator.roads.track import load_track

SIMULATOR_METADATA: Final = "bc.simulator"
"""The metadata record of a log that holds the simulator's own report of the drive."""

END_S: Final = 10.0  # the time after which a terminated simulator is killed


@dataclass(frozen=True)
class BuiltInSimulator:
    """The built-in simulator on a track (lake, mountain, random:SEED, hairpins:SEED)."""

    track: str
    laps: float = 1.0
    real_time: bool = False
    """Run no faster than the clock; else the simulator runs as fast as the answers come."""
    leave_off_road: bool = False
    """Put the car back only if it is stuck: off the road, a person or expert takes over."""
    start_m: float = 0.0  # the start, in metres along the track

    def __post_init__(self) -> None:
        """Raises DriveError for a track or laps that cannot be driven."""
        check_laps(self.laps)
        try:
            load_track(self.track)
        except ValueError as error:
            raise DriveError(f"{self.track}: {error}") from None


def check_laps(laps: float) -> None:
    if not 0 < laps <= MAX_LAPS:
        raise DriveError(f"--laps {laps:g}: give a number above 0 and up to {MAX_LAPS:,}")


def drive_and_log(
    pilot: Pilot,
    simulator: BuiltInSimulator,
    config: DriveConfig,
    log: Path,
    *,
    overwrite: bool = False,
    shows_progress: bool = True,
) -> dict[str, Any]:
    """Drive the built-in simulator, in lock-step unless it keeps real time, and log the drive. Returns the
    simulator's report.

    Raises DriveError if the simulator fails, KeyboardInterrupt if the drive was stopped. The log is finished in
    any case.
    """
    with (
        stop_signals() as stopped,
        DriveServer(pilot, config, log, overwrite=overwrite, port=0, track=simulator.track) as server,
    ):
        report = drive_built_in(server, simulator, stopped, shows_progress=shows_progress)
        if not report:
            raise KeyboardInterrupt
        return report


def drive_built_in(
    server: DriveServer, simulator: BuiltInSimulator, stopped: StopEvent, *, shows_progress: bool = True
) -> dict[str, Any]:
    """Start the built-in simulator, and serve until it has driven its laps or `stopped` is set.

    Returns the simulator's report, which the log keeps, too; empty if the drive was stopped. Raises DriveError if
    the simulator fails. Without `shows_progress`, it draws no bar on the terminal.
    """

    def has_ended() -> bool:
        report_share(min(1.0, (server.session.summary.laps or 0.0) / simulator.laps))
        return process.poll() is not None

    with _process(server, simulator, shows_progress=shows_progress) as process:
        server.run(until=has_ended, stopped=stopped)
        if process.poll() is None:
            return {}
        output, errors = process.communicate()
        if process.returncode != 0:
            why = (errors or b"").decode(errors="replace").strip().rpartition("\n")[2]
            code = f"the simulator on {simulator.track} ended with exit code {process.returncode}"
            raise DriveError(f"{code}: {why}" if why else code)
        report: dict[str, Any] = json.loads(output)
        if report["gave_up"] and not shows_progress:  # else the simulator has printed it itself
            server.notify("the car made no progress for a minute: given up")
        server.session.add_metadata(SIMULATOR_METADATA, {name: str(value) for name, value in report.items()})
        return report


@contextmanager
def _process(
    server: DriveServer, simulator: BuiltInSimulator, *, shows_progress: bool
) -> Iterator[subprocess.Popen[bytes]]:
    config = server.config
    command = [
        *(sys.executable, "-P", "-m", "simulator.cli", "--json", "--tell-world", "--port", str(server.port)),
        *("--track", simulator.track, "--laps", str(simulator.laps), "--start", str(simulator.start_m)),
        *("--expert-speed", str(config.set_speed_mph)),
        *(["--leave-off-road"] if config.takeover or simulator.leave_off_road else []),
        *(["--real-time"] if simulator.real_time else []),
    ]
    # In a new session, so that Ctrl-C reaches only this process, and the drive ends between two messages.
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=None if shows_progress else subprocess.PIPE, start_new_session=True
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


PlannedDrive = tuple[BuiltInSimulator, DriveConfig]


@dataclass(frozen=True)
class DriveResult:
    """The result of one drive, with the simulator's own report (an `AutonomousDrive`)."""

    simulator: BuiltInSimulator
    config: DriveConfig
    log: Path
    report: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        return {"set_speed_mph": self.config.set_speed_mph, "log": str(self.log), **self.report}


def evaluate(
    pilot: Pilot,
    drives: Sequence[PlannedDrive],
    logs: Path,
    *,
    overwrite: bool = False,
    notify: Callable[[str], None] = lambda text: None,
) -> Iterator[DriveResult]:
    """Drive each simulator in lock-step, log the drives, and yield each result when it is finished.

    `notify` gets a line before each drive. Raises DriveError if the simulator fails, UserError if a log exists and
    may not be overwritten.
    """
    paths = _log_paths(pilot.run, drives, logs, overwrite=overwrite)
    for (simulator, config), path in zip(drives, paths, strict=True):
        laps = f"{simulator.laps:g} lap{'' if simulator.laps == 1 else 's'}"
        notify(f"{pilot.run} on {simulator.track} at {config.set_speed_mph:g} mph, {laps}")
        report = drive_and_log(pilot, simulator, config, path, overwrite=overwrite)
        yield DriveResult(simulator, config, path, report)


def drive_runs(
    runs: Sequence[tuple[Path, Path]],
    drives: Sequence[PlannedDrive],
    tasks: Tasks,
    *,
    networks: Sequence[str] = (),
    precision: Precision = "auto",
    device: Device = "auto",
    overwrite: bool = False,
    shows_progress: bool = False,
) -> Iterator[tuple[int, DriveResult]]:
    """Let each run, given with the folder of its logs, make each of the drives. Yields the number and the result
    of each drive when it is finished. The results are those of `evaluate`.

    `networks` names the code that runs of a user's own networks need. With `shows_progress`, each simulator draws
    a bar on the terminal. Raises what `evaluate` raises.
    """
    calls = [
        (run, tuple(networks), precision, device, simulator, config, path, shows_progress)
        for run, logs in runs
        for (simulator, config), path in zip(
            drives, _log_paths(run_name(run), drives, logs, overwrite=overwrite), strict=True
        )
    ]
    yield from tasks(_drive_run, calls)


def _drive_run(
    run: Path,
    networks: tuple[str, ...],
    precision: Precision,
    device: Device,
    simulator: BuiltInSimulator,
    config: DriveConfig,
    path: Path,
    shows_progress: bool,
) -> DriveResult:
    pilot = _warm_pilot(run, networks, precision, device)
    # `_log_paths` has checked for existing logs; a drive that the cluster repeats replaces its own first log
    report = drive_and_log(pilot, simulator, config, path, overwrite=True, shows_progress=shows_progress)
    return DriveResult(simulator, config, path, report)


@lru_cache(maxsize=1)
def _warm_pilot(run: Path, networks: tuple[str, ...], precision: Precision, device: Device) -> Pilot:
    """The pilot of a run, cached, because a process makes many drives, most of them of one run."""
    for name in networks:
        load_code(name)
    pilot = load_pilot(run, precision, device)
    pilot.warm_up()
    return pilot


def _log_paths(run: str, drives: Sequence[PlannedDrive], logs: Path, *, overwrite: bool) -> list[Path]:
    """The paths of the drives' logs. Raises, before the first drive, what a later drive would raise."""
    paths = [
        logs / f"{run}-{simulator.track.replace(':', '-')}-{config.set_speed_mph:g}mph.mcap"
        for simulator, config in drives
    ]
    for path in paths:
        refuse_existing(path, overwrite, "give --drives FOLDER for another place")
    if len(set(paths)) < len(paths):
        raise DriveError("the same track at the same speed is named twice")
    return paths
