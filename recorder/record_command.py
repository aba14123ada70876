"""The work of `bc-record` and its verbs: each records, and prints what is in the log."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from common.command import check_port, flags_given, usage_errors
from common.errors import UsageError
from common.output import print_message
from common.preview import preview
from common.wheel_page import wait_until_left, wheel_page
from recorder.errors import RecordingError
from recorder.log.session_car import named_car
from recorder.new_session import make_session
from recorder.session_names import check_name
from recorder.sources.built_in_simulator import check_drive, record_simulated
from recorder.sources.frame_rate import check_row_rate
from recorder.sources.imported_rows import Imported
from recorder.sources.settings import ListenSettings, PersonDrive, SimulatedDrive
from simulator.driving.drive_limits import MAX_SPEED_MPH

if TYPE_CHECKING:
    from recorder.cli import LogFlags, Record, RecordGym, RecordListening, RecordMe
    from recorder.teleop.wheel import Wheel


def record(config: Record) -> int:
    """Record a driver of the built-in simulator. Returns the exit code, as the other verbs do."""
    with usage_errors(RecordingError):
        check_drive(config.drive)

    def write(log: Path) -> Imported:
        if config.drive == SimulatedDrive():  # nobody has asked for it: perhaps bc-import was meant
            print_message(
                f"bc-record: the built-in simulator's expert drives {config.drive.track};"
                " `bc-import FOLDER` imports a recording"
            )
        return record_simulated(config.drive, log, udacity=config.udacity, overwrite=config.log.force)

    return _make_session(config.name, config.log, write)


def record_me(config: RecordMe) -> int:
    from recorder.sources.record_person import record_person

    _check_person(config.drive)

    def write(log: Path) -> Imported:
        with contextlib.ExitStack() as stack:
            on_wheel = _page_opener(stack, log, serves=config.page, opens=config.open)
            done = record_person(config.drive, log, overwrite=config.log.force, on_wheel=on_wheel)
            if config.page:
                wait_until_left(done.path)
            return done

    return _make_session(config.name, config.log, write)


def record_listening(config: RecordListening) -> int:
    """Record simulators that connect; with --me, a person drives one."""
    if config.idle is not None and not 0 <= config.idle < math.inf:
        raise UsageError(f"--idle {config.idle:g}: expected a number of seconds, 0 or more")
    if config.port:  # 0: a free one
        check_port("--port", config.port)
    if not config.me and (flags := flags_given(config, "open", "speed", "page")):
        raise UsageError(f"{flags}: only with --me")
    _check_speed(config.speed)
    car = None if config.car is None else named_car(config.car)

    def write(log: Path) -> Imported:
        with contextlib.ExitStack() as stack:

            def show(growing: Path) -> None:
                if config.viewer:
                    stack.enter_context(preview(growing, idle_priority=True))

            settings = ListenSettings(config.host, config.port, config.idle, car, show)
            if not config.me:
                from recorder.sources.live_telemetry import listen_for_telemetry  # Socket.IO: a second to load

                return listen_for_telemetry(log, settings, overwrite=config.log.force)
            from recorder.sources.person_of_telemetry import listen_at_the_wheel

            on_wheel = _page_opener(stack, log, serves=config.page, opens=config.open)
            done = listen_at_the_wheel(settings, log, config.speed, overwrite=config.log.force, on_wheel=on_wheel)
            if config.page:
                wait_until_left(done.path)
            return done

    return _make_session(config.name, config.log, write)


def record_gym(config: RecordGym) -> int:
    from recorder.sources.gymnasium_flags import GymFlags
    from recorder.sources.record_gymnasium import GymRecording, check_recording, record_gymnasium

    car = None if config.car is None else named_car(config.car)
    environment = GymFlags(config.environment, config.expert, config.episodes)
    recording = GymRecording(environment, config.seed, config.rate, config.wander, car)
    check_recording(recording)
    return _make_session(
        config.name, config.log, lambda log: record_gymnasium(recording, log, overwrite=config.log.force)
    )


def _make_session(name: str | None, flags: LogFlags, write: Callable[[Path], Imported]) -> int:
    name = f"{datetime.now().astimezone():%Y-%m-%d_%H-%M-%S}" if name is None else name
    check_name(name)
    return make_session(flags.sessions / f"{name}.mcap", write)


def _page_opener(stack: contextlib.ExitStack, log: Path, *, serves: bool, opens: bool) -> Callable[[Wheel], None]:
    """What is called with the wheel as soon as a page can connect: it serves the page until `stack` is closed."""

    def serve_page(wheel: Wheel) -> None:
        if serves:
            stack.enter_context(wheel_page(wheel.key, {"sessions": log.parent}, opens=opens))

    return serve_page


def _check_person(drive: PersonDrive) -> None:
    """Raise UsageError for values that do not fit a person's drive."""
    _check_speed(drive.speed)
    with usage_errors(RecordingError):
        check_row_rate(drive.rate)
    if not 0 <= drive.start < math.inf:
        raise UsageError(f"--start {drive.start:g}: expected a number of metres, 0 or more")
    if drive.laps is not None and not 0 < drive.laps < math.inf:
        raise UsageError(f"--laps {drive.laps:g}: expected a number above 0")


def _check_speed(speed_mph: float) -> None:
    if not 0 < speed_mph <= MAX_SPEED_MPH:
        raise UsageError(f"--speed {speed_mph:g}: expected mph above 0 and up to {MAX_SPEED_MPH}")
