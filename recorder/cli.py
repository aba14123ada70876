"""`bc-record`: records a drive to a log."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Final, TypeAlias

import tyro

from common.command import check_port, flags_given, usage_errors
from common.errors import UsageError
from common.output import print_message
from common.preview import preview
from common.verbs import Earlier, Verb, run_verbs
from common.wheel_page import wait_until_left, wheel_page
from recorder.errors import RecordingError
from recorder.new_session import make_session
from recorder.sources.settings import ListenSettings, PersonDrive, SimulatedDrive

if TYPE_CHECKING:
    from recorder.log.session_car import Car
    from recorder.sources.imported_rows import Imported
    from recorder.teleop.wheel import Wheel

Name: TypeAlias = Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[NAME]")]
CarFlag: TypeAlias = Annotated[str | None, tyro.conf.arg(metavar="udacity|built-in|FILE.toml")]


@dataclass(frozen=True)
class LogFlags:
    """The log."""

    sessions: Path = Path("sessions")
    """Folder of the logs."""
    force: bool = False
    """Replace a session of the same name."""


@dataclass(frozen=True)
class Record:
    """Record a drive of the built-in simulator to sessions/NAME.mcap. With a verb, record what else drives: you,
    a simulator that connects, a Gymnasium environment. For a recording of another program, there is bc-import.

    bc-record lake --track lake --laps 0.5
    bc-record me --track mountain --open
    bc-record listen --viewer
    bc-record gym CarRacing-v3 --expert mine.py:drive

    `bc-record me --help` shows the flags of a verb.
    """

    RARE: ClassVar[str] = "udacity"
    REMOVED: ClassVar[dict[str, str]] = {"--copy-to": "`bc-copy sessions s3://BUCKET/sessions` copies sessions"}
    name: Name = None
    """Name of the session, without folder or ending; by default the date and time."""
    drive: tyro.conf.OmitArgPrefixes[SimulatedDrive] = field(default_factory=SimulatedDrive)
    udacity: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Also write the drive as a Udacity recording."""
    log: tyro.conf.OmitArgPrefixes[LogFlags] = field(default_factory=LogFlags)


@dataclass(frozen=True)
class RecordMe:
    """Record yourself in the built-in simulator. You drive on a page in the browser, by keyboard, mouse, touch,
    gamepad or wheel.

    bc-record me --track mountain --open
    """

    RARE: ClassVar[str] = "page"
    name: Name = None
    """Name of the session, without folder or ending; by default the date and time."""
    drive: tyro.conf.OmitArgPrefixes[PersonDrive] = field(default_factory=PersonDrive)
    open: bool = False
    """Open the browser."""
    page: bool = True
    """Serve no page, but use that of a running bc-web."""
    log: tyro.conf.OmitArgPrefixes[LogFlags] = field(default_factory=LogFlags)


@dataclass(frozen=True)
class RecordListening:
    """Record a simulator that connects, as Udacity's does in its autonomous mode: while it drives itself, or with
    --me, while you drive on a page.

    bc-record listen --viewer
    bc-record listen live-1 --me --open
    """

    RARE: ClassVar[str] = "idle host port page"
    name: Name = None
    """Name of the session, without folder or ending; by default the date and time."""
    me: bool = False
    """You drive, on a page in the browser."""
    open: bool = False
    """With --me: open the browser."""
    speed: Annotated[float, tyro.conf.arg(metavar="MPH")] = 10.0
    """With --me: the speed that the page offers to hold."""
    page: bool = True
    """With --me: serve no page, but use that of a running bc-web."""
    viewer: bool = False
    """Show the recording in Rerun."""
    car: CarFlag = None
    """The car: steering angle, wheelbase, unit of speed; by default Udacity's."""
    idle: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None
    """End after this long without data."""
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 admits other machines."""
    port: int = 4567
    """Port to listen on."""
    log: tyro.conf.OmitArgPrefixes[LogFlags] = field(default_factory=LogFlags)


@dataclass(frozen=True)
class RecordGym:
    """Record an expert of yours in a Gymnasium environment.

    bc-record gym CarRacing-v3 race --expert mine.py:drive --episodes 20
    """

    RARE: ClassVar[str] = "wander"
    environment: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ID|FILE.toml")]
    """The environment: CarRacing-v3, MODULE:ID, or a file of its settings."""
    name: Name = None
    """Name of the session, without folder or ending; by default the date and time."""
    expert: Annotated[str | None, tyro.conf.arg(metavar="MODULE:FUNCTION")] = None
    """Your driver, (env, observation) to action; also FILE.py:FUNCTION."""
    episodes: int = 1
    """Episodes, each with the next seed."""
    seed: int = 0
    """The first episode's seed."""
    rate: Annotated[float | None, tyro.conf.arg(metavar="HZ")] = None
    """Rows a second; by default each step is a row."""
    wander: float = 0.0
    """Standard deviation of noise in the expert's steering, such as 0.1."""
    car: CarFlag = None
    """The car: steering angle, wheelbase, unit of speed; by default Udacity's."""
    log: tyro.conf.OmitArgPrefixes[LogFlags] = field(default_factory=LogFlags)


EARLIER: Final = (
    Earlier("--listen", "listen"),
    Earlier("--driver", "me", value="me", renamed={"listen": "--me"}),
    Earlier("--gym", "gym", moved=1),
)


def _record(config: Record) -> int:
    from recorder.sources.built_in_simulator import check_drive, record_simulated  # NumPy, Protobuf, OpenCV

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


def _record_me(config: RecordMe) -> int:
    from recorder.sources.record_person import record_person

    _check_person(config.drive)

    def write(log: Path) -> Imported:
        with _page(log, serves=config.page, opens=config.open) as on_wheel:
            return record_person(config.drive, log, overwrite=config.log.force, on_wheel=on_wheel)

    return _make_session(config.name, config.log, write)


def _record_listening(config: RecordListening) -> int:
    if config.idle is not None and not 0 <= config.idle < math.inf:
        raise UsageError(f"--idle {config.idle:g}: expected a number of seconds, 0 or more")
    if config.port:  # 0: a free one
        check_port("--port", config.port)
    if not config.me and (flags := flags_given(config, "open", "speed", "page")):
        raise UsageError(f"{flags}: only with --me")
    _check_speed(config.speed)
    car = _car(config.car)

    def write(log: Path) -> Imported:
        with contextlib.ExitStack() as stack:

            def show(growing: Path) -> None:
                if config.viewer:
                    stack.enter_context(preview(growing, idle_priority=True))

            settings = ListenSettings(config.host, config.port, config.idle, car, show)
            from recorder.sources.live_telemetry import listen_at_the_wheel, listen_for_telemetry  # Socket.IO

            if not config.me:
                return listen_for_telemetry(log, settings, overwrite=config.log.force)

            on_wheel = stack.enter_context(_page(log, serves=config.page, opens=config.open))
            return listen_at_the_wheel(settings, log, config.speed, overwrite=config.log.force, on_wheel=on_wheel)

    return _make_session(config.name, config.log, write)


def _record_gym(config: RecordGym) -> int:
    from recorder.sources.record_gymnasium import GymRecording, check_recording, record_gymnasium
    from recorder.sources.settings import GymFlags

    environment = GymFlags(config.environment, config.expert, config.episodes)
    recording = GymRecording(environment, config.seed, config.rate, config.wander, _car(config.car))
    check_recording(recording)
    return _make_session(
        config.name, config.log, lambda log: record_gymnasium(recording, log, overwrite=config.log.force)
    )


def _make_session(name: str | None, flags: LogFlags, write: Callable[[Path], Imported]) -> int:
    name = f"{datetime.now().astimezone():%Y-%m-%d_%H-%M-%S}" if name is None else name
    return make_session(flags.sessions, name, write)


def _car(name: str | None) -> Car | None:
    from recorder.log.session_car import named_car

    return None if name is None else named_car(name)


@contextlib.contextmanager
def _page(log: Path, *, serves: bool, opens: bool) -> Iterator[Callable[[Wheel], None]]:
    """What is called with the wheel as soon as a page can connect: it serves the page until the user leaves it."""
    with contextlib.ExitStack() as stack:

        def serve_page(wheel: Wheel) -> None:
            if serves:
                stack.enter_context(wheel_page(wheel.key, {"sessions": log.parent}, opens=opens))

        yield serve_page
        if serves:
            wait_until_left(log)


def _check_person(drive: PersonDrive) -> None:
    from recorder.sources.settings import check_row_rate

    _check_speed(drive.speed)
    with usage_errors(RecordingError):
        check_row_rate(drive.rate)
    if not 0 <= drive.start < math.inf:
        raise UsageError(f"--start {drive.start:g}: expected a number of metres, 0 or more")
    if drive.laps is not None and not 0 < drive.laps < math.inf:
        raise UsageError(f"--laps {drive.laps:g}: expected a number above 0")


def _check_speed(speed_mph: float) -> None:
    from simulator.driving.drive_limits import MAX_SPEED_MPH

    if not 0 < speed_mph <= MAX_SPEED_MPH:
        raise UsageError(f"--speed {speed_mph:g}: expected mph above 0 and up to {MAX_SPEED_MPH}")


def main() -> None:
    if any(word.partition("=")[0] == "--from" for word in sys.argv[1:]):  # of version 0.3
        from recorder.import_cli import import_for_record

        import_for_record(sys.argv[1:])
    verbs = {
        "me": Verb(RecordMe, _record_me),
        "listen": Verb(RecordListening, _record_listening),
        "gym": Verb(RecordGym, _record_gym),
    }
    run_verbs("bc-record", Verb(Record, _record), verbs, EARLIER)
