"""A folder from the simulator's training mode: `driving_log.csv` and the pictures that its rows name."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from common.untrusted import open_regular
from recorder.errors import RecordingError, readable
from recorder.log.session_car import UDACITY, Car
from recorder.sources.csv_lines import LineSplitter
from recorder.sources.imported_rows import FROM_1970, recording_metadata
from recorder.sources.picture_folder import PictureFolder
from recorder.sources.recorded_row import RawRecording
from recorder.sources.udacity_csv import UTF16_MARKS, RowReader

CSV_NAME: Final = "driving_log.csv"
MAX_CSV_BYTES: Final = 1 << 30  # 200 hours of driving

_BLOCK_BYTES: Final = 1 << 16


def read_udacity(folder: Path, car: Car | None = None) -> RawRecording:
    """The recording in `folder`. Raises RecordingError if there is no csv in it, or it cannot be read."""
    csv = folder / CSV_NAME
    with readable(folder):
        if folder.is_file():
            raise RecordingError(f"{folder}: a file; give the folder that holds {CSV_NAME} and IMG/")
        if not folder.is_dir():
            raise RecordingError(f"{folder}: no such folder; give the folder that holds {CSV_NAME} and IMG/")
        if not csv.is_file():
            raise RecordingError(
                f"{folder}: no {CSV_NAME} in it; give the folder that the simulator recorded into"
            )
        check_csv(folder)
        if not csv.stat().st_size:
            raise RecordingError(f"{csv}: an empty file: no drive was recorded")
        pictures = udacity_pictures(folder)
    reader = RowReader()
    rows = [row for line, content in enumerate(_lines(csv), 1) if (row := reader.read(line, content)) is not None]
    metadata = recording_metadata("udacity", folder, car)
    if reader.is_of_another_calendar:
        metadata |= FROM_1970
    return RawRecording(
        folder,
        metadata,
        rows,
        time_unit="ns",
        mph=(car or UDACITY).mph,
        folder=pictures,
        keeps_rows_without_pictures=True,
        without_rows=f"{csv}: no usable row",
        hint="; if its columns are others, name them with --columns",
    )


def udacity_pictures(folder: Path) -> PictureFolder:
    """The pictures in the first of these folders that has them: IMG/ next to the csv, the csv's folder, ../IMG."""
    root = Path(os.path.realpath(folder))
    return PictureFolder([root / "IMG", root, root.parent / "IMG"])


def _lines(csv: Path) -> Iterator[bytes]:
    splitter = LineSplitter()
    with readable(csv), open_regular(csv) as stream:
        if stream.read(2) in UTF16_MARKS:  # PowerShell's `>` writes it
            stream.seek(0)
            text = io.TextIOWrapper(stream, "utf-16", errors="replace")
            yield from (line.rstrip("\r\n").encode() for line in text)
            return
        stream.seek(0)
        while block := stream.read(_BLOCK_BYTES):
            yield from splitter.feed(block)
    if last := splitter.rest():
        yield last


def check_csv(folder: Path) -> None:
    """Raise RecordingError if the csv in `folder` is a link out of it, or far too large; OSError without a csv."""
    csv = folder / CSV_NAME
    if csv.is_symlink() and not Path(os.path.realpath(csv)).is_relative_to(os.path.realpath(folder)):
        raise RecordingError(
            f"{csv}: a link out of the recording, which is not followed; give a folder of its own"
        )
    if csv.stat().st_size > MAX_CSV_BYTES:
        raise RecordingError(f"{csv}: larger than {MAX_CSV_BYTES / 1e9:.0f} GB, which no drive writes")
