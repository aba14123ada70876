"""Imports a recording of any kind: a reader reads it, its rows are cleaned, and a log is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from common import Skipped
from common.files import refuse_existing
from common.progress import track
from recorder.errors import RecordingError
from recorder.log.session_car import Car
from recorder.sources.clean import CleanRecording, clean, rows_to_write
from recorder.sources.csv_recording import has_csv, read_csv
from recorder.sources.donkeycar_tub import read_tub
from recorder.sources.find_recording import Kind, is_udacity, kind_of, recordings_near
from recorder.sources.imported_rows import Imported, SkippedEvents, write_log
from recorder.sources.mcap_recording import read_log
from recorder.sources.recorded_row import RawRecording
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
        rows = track(rows_to_write(cleaned, events), f"importing {source.name}", len(cleaned.rows))
        done = write_log(
            log,
            cleaned.metadata,
            iter(rows),
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
