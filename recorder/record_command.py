"""The work of `bc-record`: it records, and prints what is in the log."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

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
from recorder.sources.settings import ListenSettings, SimulatedDrive
from simulator.driving.drive_limits import MAX_SPEED_MPH

if TYPE_CHECKING:
    from recorder.cli import Record
    from recorder.sources.record_gymnasium import GymRecording
    from recorder.teleop.wheel import Wheel


def record(config: Record) -> int:
    """Record a session, and print what is in its log. Returns the exit code."""
    check_name(config.name)
    _check(config)
    return make_session(config.sessions / f"{config.name}.mcap", lambda log: _record_to(config, log))


def _record_to(config: Record, log: Path) -> Imported:
    car = None if config.car is None else named_car(config.car)
    with contextlib.ExitStack() as stack:

        def show(growing: Path) -> None:
            if config.viewer:
                stack.enter_context(preview(growing, idle_priority=True))

        settings = ListenSettings(config.host, config.port, config.idle, car, show)
        if config.drive.driver == "me":
            return _record_at_the_wheel(config, log, settings)
        if config.listen:
            from recorder.sources.live_telemetry import listen_for_telemetry  # Socket.IO: a second to load

            return listen_for_telemetry(log, settings, overwrite=config.force)
        if config.environment.gym is not None:
            from recorder.sources.record_gymnasium import record_gymnasium

            return record_gymnasium(replace(_gym_recording(config), car=car), log, overwrite=config.force)
        if config.drive == SimulatedDrive():  # nobody has asked for it: perhaps bc-import was meant
            print_message(
                f"bc-record: the built-in simulator's expert drives {config.drive.track};"
                " `bc-import FOLDER` imports a recording"
            )
        return record_simulated(_drive_of(config), log, udacity=config.udacity, overwrite=config.force)


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


_BUILT_IN: Final = "the built-in simulator"
_LISTEN: Final = frozenset({"listen", "idle", "viewer", "host", "port", "car"})
_AT_THE_WHEEL: Final = frozenset({"driver", "speed", "open", "page"})
_ROAD: Final = frozenset({"track", "laps", "rate"})
_FLAGS_OF: Final[Mapping[str, frozenset[str]]] = {
    _BUILT_IN: _ROAD | {"driver", "speed", "recovery", "noise", "seed", "udacity"},
    "--driver me": _ROAD | _AT_THE_WHEEL | {"start"},
    "--listen": _LISTEN,
    "--listen --driver me": _LISTEN | _AT_THE_WHEEL,
    "--gym ID": frozenset({"gym", "expert", "episodes", "wander", "seed", "rate", "car"}),
}
"""What can be recorded, and the flags that each uses. All use the flags of the log."""
_OF_THE_LOG: Final = frozenset({"name", "sessions", "force", "drive", "environment"})


def _recorded(config: Record) -> str:
    """What is recorded: a key of `_FLAGS_OF`."""
    if config.environment.gym is not None:
        return "--gym ID"
    flags = ["--listen"] * config.listen + ["--driver me"] * (config.drive.driver == "me")
    return " ".join(flags) or _BUILT_IN


def _refuse_unused(config: Record) -> None:
    """Raise UsageError for flags that what is recorded does not use."""
    what = _recorded(config)
    for group in (config, config.drive, config.environment):
        unused = [flag.name for flag in fields(group) if flag.name not in _FLAGS_OF[what] | _OF_THE_LOG]
        if flags := flags_given(group, *unused):
            if what != _BUILT_IN:
                raise UsageError(f"{flags}: not with {what}")
            first = flags.partition(",")[0].removeprefix("--").removeprefix("no-").replace("-", "_")
            users = [name for name, used in _FLAGS_OF.items() if first in used]
            shortest = [name for name in users if not any(other != name and other in name for other in users)]
            raise UsageError(f"{flags}: only with {' or '.join(shortest)}")


def _check(config: Record) -> None:
    """Raise UsageError for values that are never valid, and for flags that do not go together."""
    _refuse_unused(config)
    if config.idle is not None and not 0 <= config.idle < math.inf:
        raise UsageError(f"--idle {config.idle:g}: expected a number of seconds, 0 or more")
    if config.port:  # 0: a free one
        check_port("--port", config.port)
    if config.environment.gym is not None:
        from recorder.sources.record_gymnasium import check_recording

        check_recording(_gym_recording(config))
    elif config.drive.driver == "me":
        _check_at_the_wheel(config)
    elif not config.listen:
        with usage_errors(RecordingError):
            check_drive(_drive_of(config))


def _check_at_the_wheel(config: Record) -> None:
    """Raise UsageError for values that do not fit a person's drive."""
    drive = config.drive
    if len(drive.speed) != 1 or not 0 < drive.speed[0] <= MAX_SPEED_MPH:
        raise UsageError(
            f"--speed: with --driver me, give the one speed that the page holds, above 0 mph and up to"
            f" {MAX_SPEED_MPH}"
        )
    with usage_errors(RecordingError):
        check_row_rate(_drive_of(config).rate)
    if not 0 <= drive.start < math.inf:
        raise UsageError(f"--start {drive.start:g}: expected a number of metres, 0 or more")
    if drive.laps is not None and not 0 < drive.laps < math.inf:
        raise UsageError(f"--laps {drive.laps:g}: expected a number above 0")
