"""`bc-drive`: drive the simulator with a trained network."""

from __future__ import annotations

import contextlib
import json
import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from common.command import DONE, DONE_BUT_SKIPPED, run_command, usage_errors, warn
from common.errors import UsageError, counted
from common.files import refuse_existing
from common.interrupts import stop_signals
from common.location import shown_address
from common.output import print_message, print_next, print_result
from common.preview import has_display, preview
from common.progress import StatusLine
from common.streams import never_wait
from common.wheel_page import wait_until_left, wheel_page
from drive.config import DriveConfig, DriveError
from drive.drive_flags import Drive, refuse_contradictions, with_default_driver

if TYPE_CHECKING:
    from drive.at_wheel import AtWheel
    from drive.drive_session import DriveSession
    from model import Pilot
    from recorder import LogWriter


def drive(config: Drive) -> int:
    refuse_contradictions(config)
    with usage_errors(DriveError):
        settings = DriveConfig(
            set_speed_mph=config.speed,
            slow_in_curves=config.slow_in_curves,
            smooth_s=config.smooth,
            max_steering_per_s=config.steering_rate,
            takeover=config.takeover == "expert",
        )
    if config.log is not None and config.log.suffix != ".mcap":
        raise UsageError(f"--log {config.log}: a log's name ends in .mcap")
    path = config.log or config.drives / f"{datetime.now().astimezone():%Y-%m-%d_%H-%M-%S}.mcap"
    refuse_existing(path, config.force)  # before the seconds that torch takes to load
    if config.environment.gym is not None:
        return _drive_environment(config, settings, path)

    from common.process_settings import prepare_to_drive
    from drive.drive_server import DriveServer
    from drive.evaluation.closed_loop import BuiltInSimulator, check_laps, drive_built_in
    from model import find_run

    simulator = None
    if config.simulator is not None:
        with usage_errors(DriveError):
            check_laps(config.laps)
        is_real_time = config.real_time or config.takeover == "me"
        is_supervised = config.takeover is not None
        simulator = BuiltInSimulator(config.simulator, config.laps, is_real_time, is_supervised, config.start)
    run = find_run(config.run, config.runs)
    settings, pilot = _load(config, settings, run)
    prepare_to_drive()
    never_wait()
    with contextlib.ExitStack() as page:  # it outlives the drive, because it shows the next steps
        with (
            StatusLine() as status,
            stop_signals(max_signals=2) as stopped,
            _at_wheel(config, path, pilot.run, settings, page) as at_wheel,
        ):
            server = DriveServer(
                pilot,
                settings,
                path,
                overwrite=config.force,
                host=config.host,
                port=config.port if simulator is None else 0,  # any free port: no other simulator connects
                track=config.simulator,
                at_wheel=at_wheel,
                notify=_notify,
                show_status=status.show,
            )
            with contextlib.ExitStack() as after, server:  # the viewer ends after the log, so its file is complete
                after.enter_context(_viewer(config, server.session.writer))
                if simulator is None:
                    where = shown_address(config.host, server.port)
                    _notify(f"{pilot.run} is waiting for a simulator on {where}")
                    server.run(stopped=stopped)
                else:
                    if at_wheel is not None:
                        _notify("the drive begins when you open the page; Ctrl-C ends it")
                        if not at_wheel.wait_for_page(stopped):
                            raise DriveError(f"{path}: nothing was driven: the page was not opened")
                    drive_built_in(server, simulator, stopped, shows_progress=False)
                if server.session.is_empty:
                    raise DriveError(f"{path}: nothing was driven: {server.no_drive_reason}")
        code = _print_drives(server.sessions, config, run)
        if at_wheel is not None:
            from drive.driven_car import keep_supervised

            code = max(code, keep_supervised(run, settings, config.simulator, server.session))
            if config.page:
                wait_until_left(path)
        return code


@contextlib.contextmanager
def _at_wheel(
    config: Drive, log: Path, run: str, settings: DriveConfig, page: contextlib.ExitStack
) -> Iterator[AtWheel | None]:
    """The wheel of a person who supervises the network, or None. The page lasts as long as `page`."""
    if config.takeover != "me":
        yield None
        return
    from drive.at_wheel import AtWheel
    from recorder.sources.eye_pictures import EYE_HZ, EyePictures
    from recorder.teleop.frame_state import hello
    from recorder.teleop.wheel import Wheel
    from simulator.driving.simulation import Simulation

    where = config.simulator or f"the simulator that connects to {shown_address(config.host, config.port)}"
    # the simulator sends small pictures and the car's pose: this process renders the page's pictures
    simulation = None if config.simulator is None else Simulation(config.simulator)
    about = hello(
        "drive",
        log,
        track=None if simulation is None else simulation.track,
        run=run,
        picture_hz=None if simulation is None else EYE_HZ,
        hold_mph=settings.set_speed_mph,
    )
    with Wheel(f"{run} drives {where}", log, about) as wheel, contextlib.ExitStack() as rendering:
        if config.page:
            folders = {"sessions": config.sessions, "runs": config.runs, "drives": log.parent}
            page.enter_context(wheel_page(wheel.key, folders, opens=config.open))
        eye = None if simulation is None else rendering.enter_context(EyePictures(simulation, wheel))
        yield AtWheel(wheel, settings, eye)


def _load(config: Drive, settings: DriveConfig, run: Path) -> tuple[DriveConfig, Pilot]:
    from drive.driven_car import driven_car, other_steering
    from model import load_pilot
    from model.runs.run_folder import load_named
    from recorder.log.session_car import BUILT_IN

    load_named([config.network], [run])
    car = driven_car(run, config.car) if config.simulator is None else BUILT_IN
    if line := other_steering(run, car):
        _notify(line)
    pilot = load_pilot(run, config.precision, config.device)
    pilot.warm_up()
    return replace(settings, car=car), pilot


def _drive_environment(config: Drive, settings: DriveConfig, path: Path) -> int:
    from drive.drive_server import drive_metadata
    from drive.drive_session import DriveSession
    from drive.gymnasium_drive import check_pedals, drive_gymnasium, mean_reward
    from model import find_run
    from recorder import LogWriter
    from recorder.sources.gymnasium_car import GymnasiumCar

    run = find_run(config.run, config.runs)
    never_wait()
    with GymnasiumCar(config.environment) as car, stop_signals() as stopped, contextlib.ExitStack() as after:
        check_pedals(car)
        settings, pilot = _load(config, settings, run)
        source = {"simulator": car.name, "gym.args": json.dumps(car.settings.args), "gym.action": car.actions.text}
        metadata = drive_metadata(pilot, settings) | source
        writer = LogWriter(path, metadata, overwrite=config.force, live=True)
        session = after.enter_context(DriveSession(pilot, settings, writer, _notify))
        after.enter_context(_viewer(config, writer))
        episodes = []
        for episode in drive_gymnasium(session, car, config.seed, config.environment.episodes, stopped):
            episodes.append(episode)
            steps = counted(episode.steps, "step")
            print_result(f"seed {episode.seed}: {steps}, reward {episode.reward:,.1f}, {episode.end}")
        if session.is_empty:
            raise DriveError(f"{path}: nothing was driven: stopped before the first step")
    if len(episodes) > 1:
        print_result(f"reward {mean_reward(episodes):,.1f} on average")
    return _print_drives([session], config, run)


def _notify(text: str) -> None:
    print_message(f"bc-drive: {text}")


def _viewer(config: Drive, writer: LogWriter) -> contextlib.AbstractContextManager[object]:
    """The viewer of a drive, if wanted: a separate process that reads the growing log. The drive gets
    nothing from it. Without a display, a notice names the command that shows the log."""
    target = config.viewer
    if target == "auto" and not has_display():
        _notify(f"watch it with `bc-play {shlex.quote(str(writer.path))} --follow`")
        target = "off"
    elif target == "auto":
        target = "window" if sys.platform != "win32" else "off"  # Windows cannot show a growing log
    if target == "off":
        return contextlib.nullcontext()
    return preview(writer.part, target, overwrite=config.force, idle_priority=True, notify=print_message)


def _print_drives(sessions: Sequence[DriveSession], config: Drive, run: Path) -> int:
    """Print the summaries of a run's drives. Returns the exit code. Raises DriveError if no telemetry could be
    used."""
    from drive.log.summary_lines import summary_lines

    code = DONE
    for session in sessions:
        log, summary = session.writer.path, session.summary
        print_result(f"{log}: {counted(session.log.frames, 'frame')}")
        for line in summary_lines(summary):
            print_result(f"  {line}")
        if summary.bad or summary.side_problems or summary.without_number:
            code = DONE_BUT_SKIPPED
        if session.log.dropped_pictures or session.log.dropped_rows:
            code = warn(
                f"{log}: the disk was too slow: {counted(session.log.dropped_pictures, 'picture')} and"
                f" {counted(session.log.dropped_rows, 'row')} were not written; log to a faster disk with --log"
            )
    if all(session.summary.is_all_lost for session in sessions):
        raise DriveError(f"nothing was driven: {sessions[0].summary.no_drive_reason}")
    _print_next(sessions, config, run)
    return code


def _print_next(sessions: Sequence[DriveSession], config: Drive, run: Path) -> None:
    """Print the next command. With --takeover, it learns from the takeovers, if there are any; else it shows the
    last drive."""
    from model.runs.run_files import run_argument

    with_takeovers = [
        session for session in sessions if session.summary.takeovers + session.summary.manual_stretches
    ]
    if config.takeover is not None and with_takeovers:
        logs = " ".join(shlex.quote(str(session.writer.path)) for session in with_takeovers)
        times = sum(session.summary.takeovers + session.summary.manual_stretches for session in with_takeovers)
        command = f"bc-train continue {run_argument(run)} --takeovers {logs}"
        print_next(command, f"it learns from {counted(times, 'takeover')}")
    elif driven := [session for session in sessions if session.log.frames]:
        print_next(f"bc-play {shlex.quote(str(driven[-1].writer.path))}")


def main() -> None:
    sys.argv[1:] = with_default_driver(sys.argv[1:])
    run_command("bc-drive", Drive, drive)
