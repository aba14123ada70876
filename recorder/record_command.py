"""The work of `bc-record`: it records or imports, and prints what is in the log."""

from __future__ import annotations

import contextlib
import math
import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from common.command import check_port, flags_given, usage_errors, warn_skipped
from common.errors import UsageError, counted, printable
from common.location import Url, local_path
from common.output import print_message, print_next, print_result
from common.preview import preview
from common.wheel_page import wait_until_left, wheel_page
from recorder.errors import RecordingError
from recorder.log.session_car import named_car
from recorder.log_copy_cli import copy_recording, refuse_copying, refuse_taken_name
from recorder.rows.label_plan import wrong_timing
from recorder.rows.odd_stretches import odd_advice, odd_lines
from recorder.sources.built_in_simulator import check_drive, record_simulated
from recorder.sources.frame_rate import check_rate, check_row_rate
from recorder.sources.gymnasium_flags import GYM_FLAGS
from recorder.sources.imported_rows import Imported
from recorder.sources.recording_kinds import import_recording, refuse_to_watch
from recorder.sources.settings import ListenSettings, SimulatedDrive, Topics
from recorder.upkeep.log_info import describe
from simulator.driving.drive_limits import MAX_SPEED_MPH

if TYPE_CHECKING:
    from recorder.cli import Record
    from recorder.sources.record_gymnasium import GymRecording
    from recorder.teleop.wheel import Wheel


def record(config: Record) -> int:
    _refuse_contradictions(config)
    name = f"{config.name}.mcap"
    if isinstance(config.sessions, Url):
        refuse_copying(config.sessions)
        refuse_taken_name(config.sessions / name, config.force)
        config = replace(config, sessions=Path("sessions"), copy_to=config.sessions)
    elif config.copy_to is not None:
        refuse_copying(config.copy_to)
    done = _record_to(config, local_path(config.sessions) / name)
    code = warn_skipped(done.skipped)
    for recorded in (done, *done.others):
        _print_recorded(recorded)
        if config.copy_to is not None:
            code = max(code, copy_recording(recorded.path, config.copy_to, config.force))
    folder = done.path.parent
    print_next(f"bc-index --sessions {shlex.quote(str(folder))}" if folder != Path("sessions") else "bc-index")
    return code


def _print_recorded(done: Imported) -> None:
    """Print what is in a log, and what is perhaps odd."""
    for notice in done.notices:
        print_message(notice)
    size_mb = done.path.stat().st_size / 1e6
    print_result(
        f"{done.path}: {counted(done.rows, 'row')}, {counted(done.pictures, 'picture')}, {size_mb:,.1f} MB"
    )
    info = describe(done.path, with_tags=False)
    if info.lag is not None and info.lag.is_mirrored:
        print_message(f"{done.path}: its pictures turn the other way: is left right?", style="yellow")
    if info.lag is not None and (timing := wrong_timing(info.lag)):
        print_message(f"{done.path}: its steering is {timing}", style="yellow")
    odd = info.odd or ()
    for line in odd_lines(odd):
        print_message(line, heading="odd:", style="yellow")
    for line in odd_advice(odd, done.path):
        print_message(line)


def _record_to(config: Record, log: Path) -> Imported:
    car = None if config.car is None else named_car(config.car)
    source, rate_hz, overwrite = config.source, config.rate, config.force
    with contextlib.ExitStack() as stack:

        def show(growing: Path) -> None:
            if config.viewer:
                stack.enter_context(preview(growing, idle_priority=True))

        settings = ListenSettings(config.host, config.port, config.idle, car, show)
        if config.drive.driver == "me":
            return _record_at_the_wheel(config, log, settings)
        if config.listen:
            from recorder.sources.live_telemetry import listen_for_telemetry  # Socket.IO: a second to load

            return listen_for_telemetry(log, settings, overwrite=overwrite)
        if config.environment.gym is not None:
            from recorder.sources.record_gymnasium import record_gymnasium

            return record_gymnasium(replace(_gym_recording(config), car=car), log, overwrite=overwrite)
        if source is not None and config.watch:
            from recorder.sources.udacity_follow import watch_udacity

            refuse_to_watch(source)
            return watch_udacity(
                source, log, rate_hz=rate_hz, idle_s=config.idle, car=car, overwrite=overwrite, on_started=show
            )
        if source is not None:
            return import_recording(
                source, log, config.topics, columns=config.columns, rate_hz=rate_hz, car=car, overwrite=overwrite
            )
        if config.drive == SimulatedDrive():  # nobody has asked for it: perhaps --from was forgotten
            print_message(
                f"bc-record: the built-in simulator's expert drives {config.drive.track};"
                " --from FOLDER imports a recording"
            )
        return record_simulated(_drive_of(config), log, udacity=config.udacity, overwrite=overwrite)


def _record_at_the_wheel(config: Record, log: Path, settings: ListenSettings) -> Imported:
    """Record a person in the built-in simulator, or, with --listen, in one that connects."""
    with contextlib.ExitStack() as stack:

        def serve_page(wheel: Wheel) -> None:
            if config.page:
                stack.enter_context(wheel_page(wheel.key, {"sessions": log.parent}, opens=config.open))

        if config.listen:
            from recorder.sources.person_of_telemetry import listen_at_the_wheel  # Socket.IO: a second to load

            speed_mph = config.drive.speed[0]
            done = listen_at_the_wheel(settings, log, speed_mph, overwrite=config.force, on_wheel=serve_page)
        else:
            from recorder.sources.record_person import record_person  # OpenCV

            done = record_person(_drive_of(config), log, overwrite=config.force, on_wheel=serve_page)
        if config.page:
            wait_until_left(done.path)
        return done


def _drive_of(config: Record) -> SimulatedDrive:
    return config.drive if config.rate is None else replace(config.drive, rate=config.rate)


def _gym_recording(config: Record) -> GymRecording:
    from recorder.sources.record_gymnasium import GymRecording

    return GymRecording(config.environment, config.drive.seed, config.rate, config.wander)


def _refuse_contradictions(config: Record) -> None:
    name = config.name
    if isinstance(config.sessions, Url) and config.copy_to is not None:
        raise UsageError(f"--sessions {config.sessions}: the log is already copied there: leave out --copy-to")
    if not name or name.startswith((".", "-")) or set(name) & set('/\\:*?"<>|') or printable(name) != name:
        raise UsageError(f"{name!r}: not a name for a session; give a plain one, such as `bc-record lake`")
    if name.endswith(".mcap"):
        command = f"bc-record {shlex.quote(name.removesuffix('.mcap'))}"
        raise UsageError(f"{name}: give the name without its ending: `{command}`")
    if config.source is not None and config.listen:
        raise UsageError("--from and --listen: give one of them")
    if config.watch and config.source is None:
        raise UsageError("--watch follows a folder: give it with --from FOLDER")
    if (
        (config.source is not None or config.listen)
        and (config.udacity is not None or config.drive != SimulatedDrive())
        and not (config.listen and config.drive.driver == "me")
    ):
        raise UsageError(
            "--from and --listen record other drives; --udacity, --track and so on are for the built-in simulator"
        )
    if config.listen and config.rate is not None:
        raise UsageError("--rate: telemetry is recorded when it comes; leave it out")
    if not (config.watch or config.listen) and (config.idle is not None or config.viewer):
        raise UsageError("--idle and --viewer go with --watch or --listen")
    if config.topics != Topics() and (config.source is None or config.watch):
        raise UsageError("--image, --steering and --steering-scale go with --from, without --watch")
    scale = config.topics.steering_scale
    if not math.isfinite(scale) or scale == 0:
        raise UsageError(f"--steering-scale {scale:g}: expected a number other than 0")
    if config.columns and (config.source is None or config.watch):
        raise UsageError("--columns goes with --from, without --watch")
    if config.idle is not None and not 0 <= config.idle < math.inf:
        raise UsageError(f"--idle {config.idle:g}: expected a number of seconds, 0 or more")
    if config.port:  # 0: a free one
        check_port("--port", config.port)
    persons = flags_given(config, "open", "page") or flags_given(config.drive, "start")
    if config.drive.driver != "me" and persons:
        raise UsageError(f"{persons}: only with --driver me")
    if config.drive.driver == "me" and config.udacity is not None:
        raise UsageError("--udacity: only for a simulated driver, not with --driver me")
    if config.environment.gym is not None:
        _refuse_beside_gym(config)
        return
    if config.car is not None and config.source is None and not config.listen:
        raise UsageError("--car goes with --from, --listen or --gym: the built-in simulator's is known")
    if (flags := flags_given(config.environment, *GYM_FLAGS)) or (flags := flags_given(config, "wander")):
        raise UsageError(f"{flags}: only with --gym ID")
    if config.drive.driver == "me":
        _check_at_the_wheel(config)
        return
    with usage_errors(RecordingError):
        if config.source is not None:
            check_rate(config.rate)
        else:
            check_drive(_drive_of(config))


def _refuse_beside_gym(config: Record) -> None:
    from recorder.sources.record_gymnasium import check_recording

    if flags := flags_given(config, "source", "watch", "listen", "udacity"):
        raise UsageError(f"{flags.replace('--source', '--from')}: not with --gym, which is recorded itself")
    if replace(config.drive, seed=0) != SimulatedDrive():
        raise UsageError("--track, --driver and so on are for the built-in simulator, not for --gym")
    check_recording(_gym_recording(config))


def _check_at_the_wheel(config: Record) -> None:
    """Raise UsageError for flags that do not fit a person's drive."""
    drive = config.drive
    if flags := flags_given(drive, "recovery", "noise", "seed"):
        raise UsageError(f"{flags}: only for a simulated driver, not with --driver me")
    if len(drive.speed) != 1 or not 0 < drive.speed[0] <= MAX_SPEED_MPH:
        raise UsageError(
            f"--speed: with --driver me, give the one speed that the page holds, above 0 mph and up to"
            f" {MAX_SPEED_MPH}"
        )
    if config.listen:
        if flags := flags_given(drive, "track", "laps", "start"):
            raise UsageError(f"{flags}: the simulator that connects decides; not with --listen --driver me")
        return
    with usage_errors(RecordingError):
        check_row_rate(_drive_of(config).rate)
    if not 0 <= drive.start < math.inf:
        raise UsageError(f"--start {drive.start:g}: expected a number of metres, 0 or more")
    if drive.laps is not None and not 0 < drive.laps < math.inf:
        raise UsageError(f"--laps {drive.laps:g}: expected a number above 0")
