"""`bc-record`: records a drive to a log."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Final, TypeAlias

import tyro

from common.verbs import Earlier, Verb, run_verbs
from recorder.sources.settings import PersonDrive, SimulatedDrive

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
    from recorder.record_command import record  # NumPy, Arrow, Protobuf, OpenCV

    return record(config)


def _record_me(config: RecordMe) -> int:
    from recorder.record_command import record_me

    return record_me(config)


def _record_listening(config: RecordListening) -> int:
    from recorder.record_command import record_listening

    return record_listening(config)


def _record_gym(config: RecordGym) -> int:
    from recorder.record_command import record_gym

    return record_gym(config)


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
