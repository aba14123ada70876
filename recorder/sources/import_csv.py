"""Imports a folder of pictures with a csv into a log."""

from __future__ import annotations

import os
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from common import Skipped
from common.car import Camera
from common.progress import track
from common.untrusted import read_bounded
from recorder.errors import RecordingError
from recorder.log.session_car import Car
from recorder.pictures.decoding import is_whole_picture
from recorder.sources.csv_columns import CsvColumns
from recorder.sources.frame_rate import describe_clock
from recorder.sources.imported_rows import (
    FROM_1970,
    NOT_WHOLE,
    STEERING_OUT_OF_RANGE,
    Imported,
    ImportedRow,
    SkippedEvents,
    recording_metadata,
    write_log,
)
from recorder.sources.udacity_recording import MAX_CSV_BYTES, MAX_PICTURE_BYTES

MISSING: Final = "pictures that a row names and no file has, or several have"
MAX_FILES: Final = 5_000_000
ENDINGS: Final = (".jpg", ".jpeg", ".png")
_NUMBER: Final = re.compile(r"[0-9]{1,18}")


def import_csv(
    source: Path,
    log: Path,
    columns: Sequence[str],
    *,
    rate_hz: float | None = None,
    steering_scale: float = 1.0,
    car: Car | None = None,
    overwrite: bool = False,
) -> Imported:
    """Write a folder of pictures and its csv to `log`; its pictures byte for byte, its rows in order.

    `source`: a csv, or a folder that has one. `columns`: its columns, as `image=frame`, `steering=angle`; also
    `left`, `right`, `throttle`, `brake`, `speed_mph`, and `time_s` or another unit. `rate_hz`: rows a second,
    needed without times; the log then begins in 1970, and skipped rows count. Else as `import_udacity`.
    """
    chosen = CsvColumns.of(columns)
    if chosen.has_times and rate_hz is not None:
        raise RecordingError("--rate: a column has the times; leave it out")
    if not chosen.has_times and rate_hz is None:
        raise RecordingError("--columns without times: give --rate ROWS_A_SECOND, or time_s=COLUMN")
    csv = _csv(source)
    folder = PictureFolder(csv.parent)
    events = SkippedEvents()
    times_ns = array("q")
    rows = _rows(csv, chosen, folder, rate_hz, steering_scale, events.skipped, times_ns)
    metadata = recording_metadata("csv", csv.parent, car) | {
        "columns": " ".join(f"{key}={name}" for key, name in chosen.names.items()),
        "steering_scale": repr(steering_scale),
        "clock": "recorded" if rate_hz is None else describe_clock(rate_hz),
        **({} if rate_hz is None else FROM_1970),
    }
    done = write_log(log, metadata, rows, events, f"{csv}: no row of it can be used", overwrite=overwrite)
    question = chosen.likely_unit(np.array(times_ns, np.int64)) if rate_hz is None else ""
    return replace(done, notices=[*done.notices, *filter(None, [question])])


def has_csv(source: Path) -> bool:
    """True for a csv, and for a folder that has one."""
    try:
        files = source.iterdir() if source.is_dir() else [source]
        return any(path.suffix.lower() == ".csv" and path.is_file() for path in files)
    except OSError:
        return False


def _csv(source: Path) -> Path:
    """The csv itself, or the only one in a folder."""
    if source.is_dir():
        tables = sorted(path for path in source.iterdir() if path.suffix.lower() in (".csv", ".tsv", ".txt"))
        tables = [path for path in tables if path.suffix.lower() == ".csv"] or tables
        if len(tables) != 1:
            names = ", ".join(path.name for path in tables[:10]) or "none"
            raise RecordingError(f"{source}: which csv? Give its path with --from; in it there are: {names}")
        source = tables[0]
    if not source.is_file():
        raise RecordingError(f"{source}: no such file; give a csv, or the folder that it is in")
    if source.stat().st_size > MAX_CSV_BYTES:
        raise RecordingError(f"{source}: larger than {MAX_CSV_BYTES / 1e9:.0f} GB, which no drive writes")
    return source


def _rows(
    csv: Path,
    columns: CsvColumns,
    folder: PictureFolder,
    rate_hz: float | None,
    steering_scale: float,
    skipped: Skipped,
    times_ns: array[int],
) -> Iterator[ImportedRow]:
    """The rows; their times are added to `times_ns`."""
    named = set[str]()
    rows = columns.rows(csv, steering_scale, skipped)
    for row in track(rows, f"importing {csv.parent.name}", len(folder.paths)):
        # a skipped row takes time, too
        time_ns = row.time_ns if rate_hz is None else round(row.index * 1e9 / rate_hz)
        pictures: dict[Camera, bytes] = {}
        for camera, name in row.pictures.items():
            path = folder.find(name)
            if path is None:
                skipped.add(MISSING, f"line {row.line}: {name[:200]}")
            elif path in named:  # the same picture twice could be on both sides of a split
                skipped.add("pictures that an earlier row names, too", f"line {row.line}: {name[:200]}")
            elif (picture := _read(path)) is None:
                skipped.add(NOT_WHOLE, f"line {row.line}: {name[:200]}")
            else:
                pictures[camera] = picture
            if path is not None:
                named.add(path)
        if not pictures:
            continue
        if abs(row.state.steering) > 1:
            skipped.add(STEERING_OUT_OF_RANGE, f"line {row.line}: {row.state.steering:g}")
        if time_ns is not None:
            times_ns.append(time_ns)
            yield ImportedRow(time_ns, row.state, pictures.items())
    for within, path in folder.paths.items():
        if path not in named:
            skipped.add("pictures without a row", within)


def _read(path: str) -> bytes | None:
    try:
        picture = read_bounded(path, MAX_PICTURE_BYTES)
    except OSError:
        return None
    return picture if is_whole_picture(picture) else None


class PictureFolder:
    """Finds a picture by its path in the folder, its name, its name without ending, or its number.

    A name or number of several pictures finds nothing. Links are not followed.
    """

    def __init__(self, root: Path) -> None:
        """Raises RecordingError for a folder that cannot be read, or has no picture."""
        self.root = root
        self.paths: dict[str, str] = {}  # by path in the root, with slashes
        self._by_name: dict[str, str | None] = {}  # None: several
        self._by_number: dict[int, str | None] = {}
        for within, path in _pictures(root):
            self.paths[within] = path
            if len(self.paths) > MAX_FILES:
                raise RecordingError(f"{root}: over {MAX_FILES:,} pictures; give a folder of one recording")
            name = within.rpartition("/")[2]
            stem = name.rpartition(".")[0]
            for key in {name, stem}:
                self._by_name[key] = None if key in self._by_name else path
            if digits := _NUMBER.findall(stem):
                number = int(digits[-1])
                self._by_number[number] = None if number in self._by_number else path
        if not self.paths:
            raise RecordingError(f"{root}: no .jpg, .jpeg or .png in it, nor in the folders in it")

    def find(self, named: str) -> str | None:
        """The path of the picture with this name in a csv; None if no picture, or several, match."""
        slashed = named.replace("\\", "/").removeprefix("./")
        if slashed in self.paths:
            return self.paths[slashed]
        name = slashed.rpartition("/")[2]
        if name in self._by_name:
            return self._by_name[name]
        whole = name.removesuffix(".0")  # some programs write whole numbers as floats
        return self._by_number.get(int(whole)) if _NUMBER.fullmatch(whole) else None


def _pictures(root: Path) -> Iterator[tuple[str, str]]:
    """The path in the root, and the path, of every picture, sorted by name."""

    def refuse(error: OSError) -> None:
        raise RecordingError(f"{error.filename}: cannot be read ({error.strerror})") from None

    for folder, folders, names in os.walk(root, onerror=refuse):
        folders.sort()
        within = os.path.relpath(folder, root).replace(os.sep, "/")
        prefix = "" if within == "." else f"{within}/"
        for name in sorted(names):
            path = os.path.join(folder, name)  # noqa: PTH118  (a Path of each would take longer)
            if name.lower().endswith(ENDINGS) and not os.path.islink(path):  # noqa: PTH114
                yield prefix + name, path
