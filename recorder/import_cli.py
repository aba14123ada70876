"""`bc-import`: makes a session of a recording that another program wrote."""

from __future__ import annotations

import contextlib
import math
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from common.command import flags_given, run_command, usage_errors
from common.errors import UsageError
from common.files import refuse_existing
from common.output import print_message
from common.preview import preview
from recorder.errors import RecordingError
from recorder.new_session import make_session, name_of_recording
from recorder.sources.settings import ImportSettings

if TYPE_CHECKING:
    from recorder.sources.clean import CleanRecording
    from recorder.sources.imported_rows import Imported


@dataclass(frozen=True)
class Import:
    """Import a recording of another program to sessions/NAME.mcap: a Udacity folder, a DonkeyCar tub, an .mcap, a
    ROS 2 bag, a LeRobot dataset, or pictures with a csv.

    bc-import ~/beta_simulator/recording
    bc-import ~/mycar/data track
    bc-import drive.mcap --image /camera/image/compressed --steering /cmd_vel.angular.z --steering-scale -1
    """

    RARE: ClassVar[str] = "idle viewer"
    source: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE")]
    """The folder or file of the recording."""
    name: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[NAME]")] = None
    """Name of the session, without folder or ending; by default the recording's."""
    settings: tyro.conf.OmitArgPrefixes[ImportSettings] = field(default_factory=ImportSettings)
    car: Annotated[str | None, tyro.conf.arg(metavar="udacity|built-in|FILE.toml")] = None
    """The car: steering angle, wheelbase, unit of speed; by default Udacity's."""
    watch: bool = False
    """Follow a Udacity folder as it is written."""
    idle: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None
    """End --watch after this long without data."""
    viewer: bool = False
    """Show --watch in Rerun."""
    sessions: Path = Path("sessions")
    """Folder of the logs."""
    force: bool = False
    """Replace a session of the same name."""


def _import(config: Import) -> int:
    _check(config)
    name = name_of_recording(config.source) if config.name is None else config.name

    def write(log: Path) -> Imported:
        free = next(new for number in range(2, 10_000) if not log.with_stem(new := f"{name}-{number}").exists())
        refuse_existing(log, config.force, f"give another name, such as {shlex.quote(free)}")
        return _import_to(config, log)

    return make_session(config.sessions, name, write)


def _import_to(config: Import, log: Path) -> Imported:
    from recorder.log.session_car import named_car  # NumPy, Arrow, Protobuf, OpenCV
    from recorder.sources.import_recording import import_recording, refuse_to_watch
    from recorder.sources.udacity_follow import watch_udacity

    car = None if config.car is None else named_car(config.car)
    source, overwrite = config.source, config.force
    if not config.watch:
        return import_recording(source, log, config.settings, car=car, overwrite=overwrite, on_read=_print_summary)
    refuse_to_watch(source)
    with contextlib.ExitStack() as stack:

        def show(growing: Path) -> None:
            if config.viewer:
                stack.enter_context(preview(growing, idle_priority=True))

        return watch_udacity(
            source,
            log,
            rate_hz=config.settings.rate,
            idle_s=config.idle,
            car=car,
            overwrite=overwrite,
            on_started=show,
        )


def _print_summary(cleaned: CleanRecording) -> None:
    """Print what was recognised, and ask what only the user can know: the flag answers in a second import."""
    from recorder.sources.find_recording import FORMAT_NAMES
    from recorder.sources.imported_rows import AFTER_QUESTIONS

    recording = cleaned.recording
    if all(row.problem for row in cleaned.rows):
        return  # the error says it
    print_message(f"{recording.path}: {FORMAT_NAMES[recording.metadata['source']]}, {cleaned.summary()}")
    for question in cleaned.questions:
        print_message(question, style="yellow")
    if cleaned.questions:
        print_message(AFTER_QUESTIONS)


def _check(config: Import) -> None:
    from recorder.sources.settings import check_rate

    settings = config.settings
    if not config.watch and (flags := flags_given(config, "idle", "viewer")):
        raise UsageError(f"{flags}: only with --watch")
    unused = (flag.name for flag in fields(settings) if flag.name != "rate")
    if config.watch and (flags := flags_given(settings, *unused)):
        raise UsageError(f"{flags}: not with --watch, which follows Udacity's simulator")
    scale, offset, age_s = settings.steering_scale, settings.steering_offset, settings.max_steering_age
    if not math.isfinite(scale) or scale == 0:
        raise UsageError(f"--steering-scale {scale:g}: expected a number other than 0")
    if not math.isfinite(offset):
        raise UsageError(f"--steering-offset {offset:g}: expected a number")
    if not 0 < age_s < math.inf:
        raise UsageError(f"--max-steering-age {age_s:g}: expected a number of seconds above 0")
    if config.idle is not None and not 0 <= config.idle < math.inf:
        raise UsageError(f"--idle {config.idle:g}: expected a number of seconds, 0 or more")
    with usage_errors(RecordingError):
        check_rate(settings.rate)


def main() -> None:
    run_command("bc-import", Import, _import)


def import_for_record(words: Sequence[str]) -> None:
    """Run the words of an earlier `bc-record NAME --from SOURCE`, which contain --from, as `bc-import`."""
    words = [part for word in words for part in (word.split("=", 1) if word.startswith("--from=") else [word])]
    at = words.index("--from")
    sys.argv[1:] = [*words[at + 1 : at + 2], *words[:at], *words[at + 2 :]]

    def run(config: Import) -> int:
        print_message(f"bc-record --from is now `bc-import {shlex.join(sys.argv[1:])}`")
        return _import(config)

    run_command("bc-import", Import, run)
