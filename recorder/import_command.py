"""The work of `bc-import`: it imports a recording, or follows it while it grows."""

from __future__ import annotations

import contextlib
import math
import shlex
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from common.command import flags_given, usage_errors
from common.errors import UsageError
from common.files import refuse_existing
from common.output import print_message
from common.preview import preview
from recorder.errors import RecordingError
from recorder.log.session_car import named_car
from recorder.new_session import make_session
from recorder.session_names import check_name, name_of_recording
from recorder.sources.clean import CleanRecording
from recorder.sources.find_recording import FORMAT_NAMES
from recorder.sources.frame_rate import check_rate
from recorder.sources.imported_rows import AFTER_QUESTIONS, Imported
from recorder.sources.recording_kinds import import_recording, refuse_to_watch

if TYPE_CHECKING:
    from recorder.import_cli import Import


def import_session(config: Import) -> int:
    """Import a recording, and print what is in its log. Returns the exit code."""
    _check(config)
    name = name_of_recording(config.source) if config.name is None else config.name
    check_name(name)

    def write(log: Path) -> Imported:
        free = next(new for number in range(2, 10_000) if not log.with_stem(new := f"{name}-{number}").exists())
        refuse_existing(log, config.force, f"give another name, such as {shlex.quote(free)}")
        return _import_to(config, log)

    return make_session(config.sessions / f"{name}.mcap", write)


def _import_to(config: Import, log: Path) -> Imported:
    car = None if config.car is None else named_car(config.car)
    source, overwrite = config.source, config.force
    if not config.watch:
        return import_recording(source, log, config.settings, car=car, overwrite=overwrite, on_read=_print_summary)
    from recorder.sources.udacity_follow import watch_udacity

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
    recording = cleaned.recording
    if all(row.problem for row in cleaned.rows):
        return  # the error says it
    print_message(f"{recording.path}: {FORMAT_NAMES[recording.metadata['source']]}, {cleaned.summary()}")
    for question in cleaned.questions:
        print_message(question, style="yellow")
    if cleaned.questions:
        print_message(AFTER_QUESTIONS)


def _check(config: Import) -> None:
    """Raise UsageError for values that are never valid, and for flags that do not go together."""
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
