"""`bc-drive`: a trained network drives the simulator."""

from __future__ import annotations

import contextlib
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.markup import escape
from rich.table import Table

from common.command import DONE, DONE_BUT_SKIPPED, check_port, flags_given, run_command, usage_errors, warn
from common.errors import UsageError, counted, printable
from common.files import refuse_existing
from common.interrupts import stop_signals
from common.location import Url
from common.location_flag import LocationFlag
from common.output import print_message, print_result, print_table
from common.preview import has_display, preview
from common.progress import StatusLine
from drive.config import DriveConfig
from drive.errors import DriveError
from recorder.sources.gymnasium_flags import GYM_FLAGS, GymFlags

if TYPE_CHECKING:
    from drive.drive_session import DriveSession
    from drive.evaluation.aggregation import AggregationRound
    from drive.evaluation.closed_loop import LogFolder


@dataclass(frozen=True)
class Drive:
    """Drive the simulator with a trained network, and log the drive.

    Start the simulator in autonomous mode before or after; Ctrl-C brakes the car and finishes the log.

    bc-drive first --log run.mcap
    bc-drive first --simulator mountain
    bc-drive racer --gym CarRacing-v3 --gym-action steering,throttle,brake --expert my_expert:drive
    """

    run: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN]")] = None
    """The run that drives, by name or folder; the newest one by default."""
    network: str | None = None
    """Code that a run's network is of, for a run of your own network: FILE.py:CLASS or package.module:CLASS."""
    log: LocationFlag | None = None
    """Where the drive is logged; by default DATE.mcap in --drives. With a URL (s3://BUCKET/drives/NAME.mcap) it is
    logged as drives/NAME.mcap, and copied when it is finished."""
    drives: LocationFlag = Path("drives")
    """Folder for the drive's log, or with --aggregate for all of them; with a URL (s3://BUCKET/drives) logs are
    made in drives/, and copied there."""
    simulator: Annotated[str | None, tyro.conf.arg(metavar="TRACK")] = None
    """Start the built-in simulator on a track (lake, mountain, random:SEED, hairpins:SEED), and end when it has
    driven."""
    laps: float = 1.0
    """Laps of the built-in simulator; with --aggregate, of each round of any simulator that reports its laps."""
    real_time: bool = False
    """The built-in simulator goes no faster than the clock; otherwise it hurries from answer to answer."""
    takeover: bool = False
    """The simulator's expert takes over where the network leaves the lane, if the simulator sends its commands, as
    the built-in one does; `bc-index --sessions drives --drives takeovers` makes samples of that."""
    aggregate: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: not)")] = None
    """So often, train on what the expert did where it took over, and drive again (dataset aggregation). Without
    --simulator, each round drives the simulator that connects."""
    epochs: int = 5
    """Epochs of each training of --aggregate."""
    sessions: LocationFlag = Path("sessions")
    """Folder of the logs that the run was trained on, for --aggregate."""
    speed: float = 10.0
    """Set speed in mph."""
    slow_in_curves: bool = False
    """Drive slower where the steering is far from straight."""
    smooth: Annotated[float, tyro.conf.arg(metavar="SECONDS")] = 0.0
    """Smooth the steering with this time constant; 0 sends what the network gives."""
    steering_rate: float = 0.0
    """The most that the steering (-1..1) may change in a second; 0: as fast as the network wants."""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """The network's arithmetic; auto takes what is fastest on this processor."""
    viewer: Annotated[str, tyro.conf.arg(metavar="auto|window|web|ADDRESS|FILE.rrd|off")] = "auto"
    """Show the drive while it goes on: in a window, in a browser, in a viewer that runs already, or in a file.
    auto: in a window where there is a display."""
    server: Literal["eventlet", "threading"] = "eventlet"
    """The server that the simulator connects to."""
    host: str = "127.0.0.1"
    """Address to listen on; other machines are let in by 0.0.0.0."""
    port: int = 4567
    """Port to listen on; the simulator connects to 4567."""
    car: Annotated[str | None, tyro.conf.arg(metavar="udacity|built-in|FILE.toml")] = None
    """The car that is driven, as in bc-record; by default the one of the run's sessions."""
    environment: tyro.conf.OmitArgPrefixes[GymFlags] = field(default_factory=GymFlags)
    seed: int = 0
    """Seed of the first reset of --gym's environment."""
    runs: LocationFlag = Path("runs")
    """Where runs are kept; those that --aggregate trains are made in runs/ and copied there, if that is a URL."""
    force: bool = False
    """Replace a log of the same name, and the file of --viewer."""


def drive(config: Drive) -> int:
    _refuse_contradictions(config)
    with usage_errors(DriveError):
        settings = DriveConfig(
            set_speed_mph=config.speed,
            slow_in_curves=config.slow_in_curves,
            smooth_s=config.smooth,
            max_steering_per_s=config.steering_rate,
            takeover=config.takeover,
        )
    if config.aggregate is not None:
        return _aggregate(config, settings)
    if config.log is not None and config.log.suffix != ".mcap":
        raise UsageError(f"--log {config.log}: a log's name ends in .mcap")
    path = config.log or config.drives / f"{datetime.now().astimezone():%Y-%m-%d_%H-%M-%S}.mcap"
    if not isinstance(path, Url):
        return _drive_to(path, config, settings)
    from recorder.log_copy_cli import copy_recording, refuse_taken_name

    refuse_taken_name(path, config.force)
    here = Path("drives") / path.name
    code = _drive_to(here, config, settings)
    return max(code, copy_recording(here, path.parent, config.force, prog="bc-drive"))


def _drive_to(path: Path, config: Drive, settings: DriveConfig) -> int:
    refuse_existing(path, config.force)  # before the seconds that torch takes to load
    if config.environment.gym is not None:
        return _drive_environment(config, settings, path)

    from drive.drive_server import DriveServer
    from drive.evaluation.simulator_process import BuiltInSimulator, check_laps, drive_built_in
    from drive.low_latency import prepare_process
    from model import find_run, load_pilot

    simulator = None
    if config.simulator is not None:
        with usage_errors(DriveError):
            check_laps(config.laps)
        simulator = BuiltInSimulator(config.simulator, config.laps, config.real_time)
    run = find_run(config.run, config.runs)
    _load_named(config, run)
    settings = _with_car(config, settings, run)
    pilot = load_pilot(run, config.precision)
    pilot.warm_up()
    prepare_process()
    with StatusLine() as status, stop_signals(max_signals=2) as stopped:
        server = DriveServer(
            pilot,
            settings,
            path,
            overwrite=config.force,
            host=config.host,
            port=config.port if simulator is None else 0,  # any free port: no other simulator connects
            mode=config.server,
            is_built_in=simulator is not None,
            notify=_notify,
            show_status=status.show,
        )

        with contextlib.ExitStack() as after, server:  # a file of the viewer's is whole when the log is
            if (viewer := _viewer_target(config, path)) is not None:
                # in a process of its own, which reads the log as it grows: nothing leads from it to the drive
                part, force = server.session.writer.part, config.force
                after.enter_context(
                    preview(part, viewer, overwrite=force, idle_priority=True, notify=print_message)
                )
            if simulator is None:
                waiting = f"{pilot.run} is waiting for a simulator on {config.host}:{server.port}"
                _notify(waiting)
                server.run(stopped=stopped)
            else:
                drive_built_in(server, simulator, stopped, shows_progress=False)
            if server.session.is_empty:
                raise DriveError(f"{path}: nothing was driven: {server.no_drive_reason}")
    return _print_drives(server.sessions)


def _with_car(config: Drive, settings: DriveConfig, run: Path) -> DriveConfig:
    """The settings of a drive, with the car that is driven, where it is known."""
    from drive.driven_car import driven_car, other_steering
    from recorder.log.session_car import built_in

    car = driven_car(run, config.car) if config.simulator is None else built_in()
    if line := other_steering(run, car):
        _notify(line)
    return replace(settings, car=car)


def _load_named(config: Drive, run: Path) -> None:
    """Run the code of --network, if the run needs it."""
    from model.runs.network_of_run import load_named
    from model.runs.run_folder import load_config

    if config.network is not None:
        load_named([config.network], [load_config(run)])


def _refuse_contradictions(config: Drive) -> None:
    """Raise UsageError for flags that would be passed over, and for what is no port."""
    if config.log is not None and (flags := flags_given(config, "drives")):
        raise UsageError(f"{flags}: is for a log that --log does not name: give one of both")
    if config.environment.gym is not None:
        others = ("simulator", "laps", "real_time", "takeover", "aggregate", "server", "host", "port")
        if flags := flags_given(config, *others, "epochs", "sessions"):
            raise UsageError(
                f"{flags}: not with --gym, which neither connects to a port nor knows where its car is"
            )
        if config.seed < 0:
            raise UsageError(f"--seed {config.seed}: a whole number from 0 on was expected")
        return
    if flags := flags_given(config.environment, *GYM_FLAGS) or flags_given(config, "seed"):
        raise UsageError(f"{flags}: only with --gym ID")
    if config.port:  # 0: a free one
        check_port("--port", config.port)
    if config.simulator is None and (flags := flags_given(config, "real_time")):
        raise UsageError(f"{flags}: only with the built-in simulator: give --simulator TRACK as well")
    if config.simulator is None and config.aggregate is None and (flags := flags_given(config, "laps")):
        raise UsageError(f"{flags}: only with --simulator TRACK or --aggregate N: else it drives until Ctrl-C")
    if config.simulator is not None and (flags := flags_given(config, "car")):
        raise UsageError(f"{flags}: the built-in simulator's car is known; leave it out")
    if config.simulator is not None and (flags := flags_given(config, "host", "port")):
        raise UsageError(f"{flags}: the built-in simulator runs on this machine and a free port; leave it out")
    if config.aggregate is None and (flags := flags_given(config, "epochs", "sessions")):
        raise UsageError(f"{flags}: only with --aggregate N")
    if config.aggregate is not None and (
        flags := flags_given(config, "log", "viewer", "precision", "force", "car")
    ):
        raise UsageError(
            f"{flags}: not with --aggregate, which names its logs, replaces nothing, shows a table and takes the"
            " fastest arithmetic; leave it out"
        )


def _drive_environment(config: Drive, settings: DriveConfig, path: Path) -> int:
    """Drive a Gymnasium environment."""
    from drive.drive_server import drive_metadata
    from drive.drive_session import DriveSession
    from drive.gymnasium_drive import check_pedals, drive_gymnasium, mean_reward
    from model import find_run, load_pilot
    from recorder import LogWriter
    from recorder.sources.gymnasium_car import GymnasiumCar

    run = find_run(config.run, config.runs)
    with GymnasiumCar(config.environment) as car, stop_signals() as stopped, contextlib.ExitStack() as after:
        check_pedals(car)
        _load_named(config, run)
        settings = _with_car(config, settings, run)
        pilot = load_pilot(run, config.precision)
        pilot.warm_up()
        source = {"simulator": car.name, "gym.args": config.environment.gym_args, "gym.action": car.actions.text}
        metadata = drive_metadata(pilot, settings) | source
        writer = LogWriter(path, metadata, overwrite=config.force, live=True)
        session = after.enter_context(DriveSession(pilot, settings, writer, _notify))
        if (viewer := _viewer_target(config, path)) is not None:
            shown = preview(writer.part, viewer, overwrite=config.force, idle_priority=True, notify=print_message)
            after.enter_context(shown)
        episodes = []
        for episode in drive_gymnasium(session, car, config.seed, config.environment.episodes, stopped):
            episodes.append(episode)
            steps = counted(episode.steps, "step")
            print_result(f"seed {episode.seed}: {steps}, reward {episode.reward:,.1f}, {episode.end}")
        if session.is_empty:
            raise DriveError(f"{path}: nothing was driven: stopped before the first step")
    if len(episodes) > 1:
        print_result(f"reward {mean_reward(episodes):,.1f} on average")
    return _print_drives([session])


def _notify(text: str) -> None:
    print_message(f"bc-drive: {text}")


def _viewer_target(config: Drive, log: Path) -> str | None:
    """The target of the viewer, None for none; without a display, a notice names the command that shows the
    log."""
    if config.viewer == "auto" and not has_display():
        _notify(f"watch it with `bc-play {shlex.quote(str(log))} --follow`")
        return None
    if config.viewer == "auto":
        return "window" if sys.platform != "win32" else None  # there a log that grows cannot be shown
    return None if config.viewer == "off" else config.viewer


def _print_drives(sessions: Sequence[DriveSession]) -> int:
    """Print the summaries of the drives; the exit code. Raises DriveError if no telemetry could be driven on."""
    from drive.log.summary_lines import summary_lines

    code = DONE
    for session in sessions:
        log, summary = session.writer.path, session.summary
        hint = f"; look at it with `bc-play {shlex.quote(str(log))}`" if session.log.frames else ""
        print_result(f"{log}: {counted(session.log.frames, 'frame')}{hint}")
        for line in summary_lines(summary):
            print_result(f"  {line}")
        if summary.bad or summary.without_number:
            code = DONE_BUT_SKIPPED
        if session.log.dropped_pictures or session.log.dropped_rows:
            code = warn(
                f"{log}: the disk was too slow: {counted(session.log.dropped_pictures, 'picture')} and"
                f" {counted(session.log.dropped_rows, 'row')} were not written; log to a faster one with --log"
            )
    if all(session.summary.is_all_lost for session in sessions):
        raise DriveError(f"nothing was driven: {sessions[0].summary.no_drive_reason}")
    return code


def _aggregate(config: Drive, settings: DriveConfig) -> int:
    """Drive and train by turns."""
    from drive.evaluation.aggregation import Aggregation, AggregationFolders, check_rounds
    from drive.evaluation.closed_loop import LogFolder
    from drive.evaluation.external_simulator import ExternalSimulator
    from drive.evaluation.simulator_process import BuiltInSimulator, check_laps
    from model import TrainConfig, find_run
    from model.runs.network_of_run import network_settings
    from model.runs.run_arguments import RUNS
    from model.runs.run_folder import load_config

    rounds: list[AggregationRound] = []
    codes = [DONE]

    assert config.aggregate is not None  # noqa: S101
    with usage_errors(DriveError, ValueError):
        check_rounds(config.aggregate)
        check_laps(config.laps)
        training = TrainConfig(epochs=config.epochs)
    simulator: BuiltInSimulator | ExternalSimulator = ExternalSimulator(config.laps, config.host, config.port)
    if config.simulator is not None:
        simulator = BuiltInSimulator(config.simulator, config.laps, config.real_time)
    drives = LogFolder.of(config.drives)
    runs = config.runs if isinstance(config.runs, Path) else RUNS
    folders = AggregationFolders(config.sessions, drives.here, runs)
    run = find_run(config.run, config.runs)
    _load_named(config, run)
    training = replace(training, **network_settings(load_config(run), run))
    aggregation = Aggregation(run, simulator, settings, config.aggregate, folders, training)
    try:
        for done in aggregation.rounds(config.server, _notify, lambda notice: codes.append(warn(notice))):
            rounds.append(done)
            codes.append(_copy_round(config, done, drives, runs / done.run if len(rounds) > 1 else None))
    finally:  # what was driven is shown, whatever stops the rest
        if rounds:
            print_table(_rounds_table(rounds))
    return max(codes)


def _rounds_table(rounds: Sequence[AggregationRound]) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in ("run", "laps", "interventions", "autonomy", "log"):
        table.add_column(heading, justify="left" if heading in ("run", "log") else "right")
    for each in rounds:
        percent = each.autonomy_percent
        table.add_row(
            escape(printable(each.run)),
            "unknown" if each.laps is None else f"{each.laps:.2f}",
            f"{each.interventions:,}",
            "unknown" if percent is None else f"{percent:.1f} %",
            escape(printable(str(each.log))),
        )
    return table


def _copy_round(config: Drive, done: AggregationRound, drives: LogFolder, trained: Path | None) -> int:
    """Copy what an aggregation's round has made to where that is kept in a store; the exit code."""
    from model.runs.stored_run import RunCopy

    problems = [drives.copy(done.log.name, False)[1]]
    if trained is not None and isinstance(config.runs, Url):
        problems.append(RunCopy(trained, config.runs / trained.name).finish())
    return max([DONE, *(warn(problem) for problem in problems if problem)])


def main() -> None:
    run_command("bc-drive", Drive, drive)
