"""`bc-import`: makes a session of a recording that another program wrote."""

from __future__ import annotations

import contextlib
import math
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from common.command import DONE, FAILED, flags_given, run_command, usage_errors, warn
from common.errors import Skipped, UsageError, UserError, first_of
from common.files import refuse_existing
from common.interrupts import interrupting_signals
from common.output import print_message
from common.preview import preview
from common.progress import track
from common.ray_flag import RayAddress, tasks_of
from common.tasks import in_processes
from recorder.errors import RecordingError
from recorder.new_session import (
    make_session,
    name_of_recording,
    plain_name,
    print_next_index,
    print_recorded,
)
from recorder.sources.settings import ImportSettings

if TYPE_CHECKING:
    from recorder.log.session_car import Car
    from recorder.sources.clean import CleanRecording
    from recorder.sources.imported_rows import Imported


@dataclass(frozen=True)
class Import:
    """Import a recording of another program to sessions/NAME.mcap: a Udacity folder, a DonkeyCar tub, an .mcap, a
    ROS 2 bag, a LeRobot dataset, or pictures with a csv.

    bc-import ~/beta_simulator/recording
    bc-import ~/mycar/data track
    bc-import ~/recordings --all
    bc-import drive.mcap --image /camera/image/compressed --steering /cmd_vel.angular.z --steering-scale -1
    """

    RARE: ClassVar[str] = "idle viewer ray"
    source: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE")]
    """The folder or file of the recording."""
    name: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[NAME]")] = None
    """Name of the session, without folder or ending; by default the recording's."""
    settings: tyro.conf.OmitArgPrefixes[ImportSettings] = field(default_factory=ImportSettings)
    car: Annotated[str | None, tyro.conf.arg(metavar="udacity|built-in|FILE.toml")] = None
    """The car: steering angle, wheelbase, unit of speed; by default Udacity's."""
    all: bool = False
    """Import every recording in the folder SOURCE."""
    ray: RayAddress = None
    """Import with --all on a Ray cluster with shared folders."""
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
    if config.all:
        return _import_all(config)
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


def _import_all(config: Import) -> int:
    """Import the recordings in a folder, several at the same time. Those that are there already are not replaced
    without --force. Returns the exit code."""
    from recorder.log.session_car import named_car
    from recorder.sources.find_recording import recordings_in

    sources: dict[Path, Path] = {}  # by log
    for source in recordings_in(config.source):
        parts = source.relative_to(config.source).parts
        log = config.sessions / f"{plain_name('-'.join(parts)) if parts else name_of_recording(source)}.mcap"
        if log in sources:
            raise RecordingError(f"{source}: would get the name of {sources[log]}; import it alone, with a NAME")
        sources[log] = source
    if not sources:
        raise RecordingError(f"{config.source}: no recording in it")
    if kept := [] if config.force else [log for log in sources if log.exists()]:
        print_message(
            f"{config.sessions}: has {first_of([log.stem for log in kept])} already; --force replaces it"
        )
    car = None if config.car is None else named_car(config.car)
    overwrite = config.force or config.ray is not None  # of a call that a cluster makes again, the log may exist
    calls = [(source, log, config.settings, car, overwrite) for log, source in sources.items() if log not in kept]
    if not calls:
        return DONE
    codes, imported = [DONE], 0
    with tasks_of(config.ray, here=in_processes) as tasks:
        results = tasks(_import_one, calls)
        for _, (done, lines, skipped) in track(results, f"importing {config.source.name}", len(calls)):
            for line in lines:
                print_message(line)
            codes += map(warn, skipped)
            if done is not None:
                print_recorded(done)
                imported += 1
    if not imported:
        return FAILED
    print_next_index(config.sessions)
    return max(codes)


def _import_one(
    source: Path, log: Path, settings: ImportSettings, car: Car | None, overwrite: bool
) -> tuple[Imported | None, list[str], list[str]]:
    """In a process or on a node: import a recording. Returns what is in its log, a summary, and what was skipped:
    perhaps the whole recording."""
    from recorder.sources.import_recording import import_recording

    lines: list[str] = []
    try:
        with interrupting_signals():
            done = import_recording(
                source,
                log,
                settings,
                car=car,
                overwrite=overwrite,
                on_read=lambda cleaned: lines.extend(_summary(cleaned)),
                show_progress=False,
            )
    except UserError as error:
        return None, lines, [str(error)]
    skipped = [f"{source}: skipped {line}" for line in done.skipped.lines()]
    return replace(done, skipped=Skipped()), [*lines, *(f"{source}: {text}" for text in done.questions)], skipped


def _summary(cleaned: CleanRecording) -> list[str]:
    """What was recognised; empty if no row can be used, because the error says it."""
    from recorder.sources.find_recording import FORMAT_NAMES

    recording = cleaned.recording
    if all(row.problem for row in cleaned.rows):
        return []
    return [f"{recording.path}: {FORMAT_NAMES[recording.metadata['source']]}, {cleaned.summary()}"]


def _print_summary(cleaned: CleanRecording) -> None:
    """Print what was recognised, and ask what only the user can know: the flag answers in a second import."""
    from recorder.sources.imported_rows import AFTER_QUESTIONS

    if not (lines := _summary(cleaned)):
        return
    print_message(*lines)
    for question in cleaned.questions:
        print_message(question, style="yellow")
    if cleaned.questions:
        print_message(AFTER_QUESTIONS)


def _check(config: Import) -> None:
    from recorder.sources.settings import check_rate

    settings = config.settings
    if config.all and (config.name is not None or config.watch):
        raise UsageError("--all: without NAME and --watch; sessions get the names of their recordings")
    if config.ray is not None and not config.all:
        raise UsageError("--ray: only with --all; one recording is imported by one machine")
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
