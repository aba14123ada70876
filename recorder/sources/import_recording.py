"""Imports a recording of any kind: a reader reads it, its rows are cleaned, and a log is written. Also summarises
one before its import."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, Literal

from common import Skipped, UserError
from common.errors import counted, printable
from common.files import refuse_existing
from common.progress import track
from recorder.errors import RecordingError
from recorder.log.session_car import Car
from recorder.sources.clean import CleanRecording, clean, rows_to_write, skip_unread
from recorder.sources.compressed_video import is_video_type
from recorder.sources.csv_recording import csv_in, has_csv, overview, read_csv
from recorder.sources.donkeycar_tub import read_tub
from recorder.sources.find_recording import FORMAT_NAMES, Kind, is_udacity, kind_of, recordings_near
from recorder.sources.imported_rows import Imported, RawRecording, SkippedEvents, write_log
from recorder.sources.mcap_messages import is_picture_type
from recorder.sources.mcap_recording import is_own_log, read_log, topics_in
from recorder.sources.settings import ImportSettings
from recorder.sources.udacity_recording import CSV_NAME, read_udacity


def import_recording(
    source: Path,
    log: Path,
    settings: ImportSettings | None = None,
    *,
    kind: Kind = "",
    car: Car | None = None,
    overwrite: bool = False,
    on_read: Callable[[CleanRecording], None] = lambda cleaned: None,
    show_progress: bool = True,
) -> Imported:
    """Import a recording to `log`: its pictures byte for byte, those of videos encoded anew.

    `settings`: what the user says of it. `kind`: its format; by default it is recognised. `car`: the recorded car,
    if the recording does not say it. `on_read` gets the recording before its pictures are read, with what only the
    user can know as questions. Raises RecordingError if nothing in it can be used, and UserError if `log` exists
    and `overwrite` is off.
    """
    refuse_existing(log, overwrite)  # before minutes of reading
    settings = settings or ImportSettings()
    events = SkippedEvents()
    recording = read_recording(source, settings, events.skipped, kind=kind, car=car, log=log)
    with recording.opened:
        cleaned = clean(recording, settings)
        on_read(cleaned)
        rows = iter(rows_to_write(cleaned, events))
        if show_progress:
            rows = track(rows, f"importing {source.name}", len(cleaned.rows))
        done = write_log(
            log,
            cleaned.metadata,
            rows,
            events,
            recording.without_rows,
            warnings=recording.warnings,
            overwrite=overwrite,
        )
    return replace(done, notices=[*done.notices, *cleaned.notices], questions=cleaned.questions)


def read_recording(
    source: Path,
    settings: ImportSettings,
    skipped: Skipped,
    *,
    kind: Kind = "",
    car: Car | None = None,
    log: Path | None = None,
) -> RawRecording:
    """The rows of a recording, without its pictures. `log` is where it will be written. Raises RecordingError."""
    if settings.columns:
        if settings.image is not None or settings.steering is not None:
            raise RecordingError("--columns already names everything to import: leave out --image, --steering")
        return read_csv(source, settings.columns, car)
    kind = kind or kind_of(source)
    if not kind:
        if hint := recordings_near(source):
            raise RecordingError(f"{source}: not a recording;{hint}")
        if has_csv(source):
            raise RecordingError(
                f"{source}: pictures with a csv? Say what its columns are: --columns image=COLUMN steering=COLUMN"
                f" --rate ROWS_A_SECOND; or, if Udacity's simulator wrote it, name it {CSV_NAME}"
            )
    if (settings.image is not None or settings.steering is not None) and kind not in ("log", "lerobot"):
        raise RecordingError(
            f"{source}: --image and --steering are for other programs' logs and LeRobot datasets; this is neither"
        )
    if kind == "log":
        return read_log(source, settings, skipped, car, log)
    if kind == "lerobot":
        from recorder.sources.lerobot_recording import read_lerobot  # Arrow's parquet, OpenCV

        return read_lerobot(source, settings, car)
    return read_tub(source, skipped, car) if kind == "tub" else read_udacity(source, car)


def refuse_to_watch(source: Path) -> None:
    """Raise RecordingError unless the Udacity simulator may write into the folder `source`."""
    if not is_udacity(source) and kind_of(source):
        raise RecordingError(
            f"{source}: --watch follows folders of the Udacity simulator, which this is not; import it when it is"
            " finished, without --watch"
        )


def import_udacity(
    folder: Path, log: Path, *, rate_hz: float | None = None, car: Car | None = None, overwrite: bool = False
) -> Imported:
    """Write the Udacity recording in `folder` to `log`; its pictures byte for byte, its rows in order.

    `rate_hz`: rows a second, from 1970 on, for a recording whose pictures' names hold no times. `car`: the
    recorded car, if it is not Udacity's. Raises RecordingError if nothing in it can be used, and UserError if
    `log` exists and `overwrite` is off.
    """
    settings = ImportSettings(rate=rate_hz)
    return import_recording(folder, log, settings, kind="udacity", car=car, overwrite=overwrite)


_MAX_LISTED: Final = 200  # topics, columns

Needs = Literal["", "topics", "columns"]


@dataclass(frozen=True)
class RecordingSummary:
    """A recording in short. `problem`: why it cannot be imported; "" if none is known."""

    path: Path
    kind: str
    rows: str = ""  # their number, in words; "" if only an import counts them
    oddities: tuple[str, ...] = ()  # parts that an import skips or cannot find
    needs: Needs = ""  # the settings that an import needs
    names: tuple[str, ...] = ()  # the topics or columns to choose from
    pictures: tuple[str, ...] = ()  # the topics with pictures
    is_own: bool = False  # a log of this toolkit, which needs no import
    problem: str = field(default="", compare=False)


def summarize_recording(source: Path) -> RecordingSummary:
    """The summary of a recording that `find_recording` found."""
    try:
        return _summary(source)
    except (UserError, OSError) as error:
        return RecordingSummary(source, "", problem=printable(str(error)))


def _summary(source: Path) -> RecordingSummary:
    skipped = Skipped()
    kind = kind_of(source)
    if kind == "log":
        return _log(source, skipped)
    if not kind:
        return _csv(source)
    settings = ImportSettings()
    recording = read_recording(source, settings, skipped)
    with recording.opened:
        cleaned = clean(recording, settings)
        skip_unread(cleaned, skipped)
    name = FORMAT_NAMES[recording.metadata["source"]]
    if kind == "tub":
        name += f", version {recording.metadata['tub_version']}"
    oddities = (*cleaned.questions, *_lines(skipped))
    return RecordingSummary(source, name, cleaned.summary(), oddities)


def _log(source: Path, skipped: Skipped) -> RecordingSummary:
    if is_own_log(source):
        return RecordingSummary(source, "session of this toolkit", is_own=True)
    types = topics_in(source, skipped)
    format_name = FORMAT_NAMES["ros2 bag" if source.is_dir() else "mcap"]
    has_pictures = [topic for topic, kind in types.items() if is_picture_type(kind) or is_video_type(kind)]
    pictures = tuple(has_pictures[:_MAX_LISTED])
    others = tuple(topic for topic in types if topic not in pictures)[:_MAX_LISTED]
    return RecordingSummary(source, format_name, "", _lines(skipped), "topics", others, pictures)


def _csv(source: Path) -> RecordingSummary:
    names, count = overview(csv_in(source))
    columns = tuple(printable(name) for name in names[:_MAX_LISTED])
    return RecordingSummary(source, FORMAT_NAMES["csv"], counted(count, "row"), needs="columns", names=columns)


def _lines(skipped: Skipped) -> tuple[str, ...]:
    return tuple(skipped.lines(max_names=3))
