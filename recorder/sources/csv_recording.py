"""Reads a folder of pictures with a csv, whose columns `--columns` names."""

from __future__ import annotations

import contextlib
import csv
import io
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

from common.car import CAMERAS
from common.errors import did_you_mean, printable
from common.untrusted import open_regular, whole_number
from recorder.errors import RecordingError, readable
from recorder.log.session_car import Car
from recorder.sources.clean import camera_named
from recorder.sources.imported_rows import RawRecording, RecordedRow, recording_metadata
from recorder.sources.picture_folder import PictureFolder
from recorder.sources.settings import TimeUnit
from recorder.sources.udacity_csv import UTF16_MARKS, read_number
from recorder.sources.udacity_recording import MAX_CSV_BYTES

MAX_LINE_CHARACTERS: Final = 100_000
TABLES: Final = (".csv", ".tsv", ".txt")
_POSITIONS: Final = frozenset(map(str, range(1, 1000)))
_NUMBERS: Final = ("steering", "throttle", "brake", "speed_mph")
_TIMES: Final[Mapping[str, TimeUnit]] = {
    "time": "s",
    "time_s": "s",
    "time_ms": "ms",
    "time_us": "us",
    "time_ns": "ns",
}
KEYS: Final = ("image", *CAMERAS, "camera", *_NUMBERS, *_TIMES)
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_DATE: Final = re.compile(r"\d{4}-\d\d-\d\d")
_SEPARATOR_LINE: Final = re.compile(r'"?sep=(.)"?\s*', re.IGNORECASE)  # the first line of Excel's
_PICTURE_AND_BLANK: Final = re.compile(r"\S+\.(jpe?g|png) +\S", re.IGNORECASE)
_LOOKED_AT: Final = 300  # rows, for a column that names cameras


def read_csv(source: Path, given: Sequence[str], car: Car | None = None) -> RawRecording:
    """The recording of a csv, or of a folder that has one. `given`: its columns, as `image=frame
    steering=angle`. Raises RecordingError for other columns, or a csv that cannot be read."""
    columns = CsvColumns.of(given)
    path = csv_in(source)
    with readable(path):
        pictures = PictureFolder([path.parent], is_deep=True)
        if not pictures.paths:
            raise RecordingError(f"{path.parent}: no .jpg, .jpeg or .png in it, nor in the folders in it")
        try:
            with open_csv(path) as text:
                rows, unit, camera_column = columns.read(path, text)
        except csv.Error as error:
            raise RecordingError(f"{path}: not a csv ({error})") from None
    metadata = recording_metadata("csv", path.parent, car) | {
        "columns": " ".join(f"{key}={name}" for key, name in columns.names.items()),
        "clock": "recorded",
    }
    return RawRecording(
        path,
        metadata,
        rows,
        time_unit=unit,
        folder=pictures,
        without_rows=f"{path}: no row of it can be used",
        camera_column=camera_column,
    )


def has_csv(source: Path) -> bool:
    """True for a csv, and for a folder that has one."""
    try:
        files = source.iterdir() if source.is_dir() else [source]
        return any(path.suffix.lower() in TABLES and path.is_file() for path in files)
    except OSError:
        return False


def csv_in(source: Path) -> Path:
    """The csv itself, or the only one in a folder."""
    if source.is_dir():
        tables = sorted(path for path in source.iterdir() if path.suffix.lower() in TABLES)
        tables = [path for path in tables if path.suffix.lower() == ".csv"] or tables
        if len(tables) != 1:
            names = ", ".join(path.name for path in tables[:10]) or "none"
            raise RecordingError(f"{source}: which csv? Give its path; in it there are: {names}")
        source = tables[0]
    if not source.is_file():
        raise RecordingError(f"{source}: no such file; give a csv, or the folder that it is in")
    if source.stat().st_size > MAX_CSV_BYTES:
        raise RecordingError(f"{source}: larger than {MAX_CSV_BYTES / 1e9:.0f} GB, which no drive writes")
    return source


def overview(source: Path) -> tuple[list[str], int]:
    """The cells of a csv's first line, its columns' names if it has a header, and the number of other lines with
    something in them. Raises RecordingError."""
    try:
        with readable(source), open_csv(source) as text:
            cells = _Cells(text)
            return cells.first, sum(1 for _ in cells.rows(has_header=True))
    except csv.Error as error:
        raise RecordingError(f"{source}: not a csv ({error})") from None


@dataclass(frozen=True)
class CsvColumns:
    """The column of each value, by name."""

    names: Mapping[str, str]

    @classmethod
    def of(cls, given: Sequence[str]) -> CsvColumns:
        """From `image=frame steering=angle`. Raises RecordingError for another form."""
        names: dict[str, str] = {}
        for text in given:
            key, separator, name = text.partition("=")
            if key not in KEYS or not separator or not name:
                hint = "" if key in KEYS else did_you_mean(key, KEYS, " ")
                raise RecordingError(
                    f"--columns {printable(text)}: expected WHAT=COLUMN, where WHAT is one of"
                    f" {', '.join(KEYS)}.{hint}"
                )
            if key in names:
                raise RecordingError(f"--columns: {key} is given twice")
            names[key] = name
        if "image" in names:
            if "center" in names:
                raise RecordingError("--columns: image and center are the same; give one of them")
            names["center"] = names.pop("image")
        if "steering" not in names or not set(CAMERAS) & names.keys():
            raise RecordingError("--columns: give at least image=COLUMN and steering=COLUMN")
        if len(_TIMES.keys() & names.keys()) > 1:
            raise RecordingError("--columns: give one column of times")
        if "camera" in names and {"left", "right"} & names.keys():
            raise RecordingError("--columns: camera= is for one picture in a row; leave out left= and right=")
        return cls(names)

    def read(self, path: Path, text: io.TextIOWrapper) -> tuple[list[RecordedRow], TimeUnit, str]:
        """The rows, the unit of their times, and a column that names cameras, if nobody has chosen it."""
        cells = _Cells(text)
        header = cells.first
        at = self._positions(path, header)
        has_header = at is not None
        if at is None:
            at = {key: int(name) - 1 for key, name in self.names.items()}
        key = next((key for key in _TIMES if key in at), None)
        unit: TimeUnit = "s" if key is None else _TIMES[key]
        rows, seen = list[RecordedRow](), list[list[str]]()
        for line, found in cells.rows(has_header):
            values = {
                key: found[position].strip() if position < len(found) else "" for key, position in at.items()
            }
            if not rows and key is not None and _iso_ns(values[key]) is not None:
                unit = "ns"
            if len(seen) < _LOOKED_AT:
                seen.append(found)
            rows.append(_row(f"line {line}", len(rows), values, key, is_date=unit == "ns" and key != "time_ns"))
        free = [name for at_, name in enumerate(header) if at_ not in at.values()] if has_header else []
        candidates = (name for name in free if _names_cameras(header.index(name), seen))
        return rows, unit, next(candidates, "") if not {"camera", "left", "right"} & self.names.keys() else ""

    def _positions(self, path: Path, header: Sequence[str]) -> dict[str, int] | None:
        """The position of each column; None if the file has no header and `--columns` has numbers from 1."""
        missing = [name for name in self.names.values() if name not in header]
        are_numbers = len(missing) == len(self.names) and all(name in _POSITIONS for name in missing)
        if are_numbers and max(map(int, missing)) <= len(header):
            return None
        for name in missing:
            hint = did_you_mean(name, header, " ")
            listed = ", ".join(printable(name[:60]) for name in header[:40]) or "none"
            raise RecordingError(f"{path}: no column {printable(name)!r}; the first line names {listed}.{hint}")
        if twice := next((name for name in self.names.values() if header.count(name) > 1), None):
            raise RecordingError(f"{path}: several columns {printable(twice)!r}; name all by number, from 1")
        return {key: header.index(name) for key, name in self.names.items()}


class _Cells:
    """The cells of a csv. Separated by the most frequent of ; tab and , in the first line, else by blanks."""

    def __init__(self, text: io.TextIOWrapper) -> None:
        self._lines = _lines(text)
        self._before = 0  # lines before the first
        line = next(self._lines, "")
        self._delimiter = ""
        if match := _SEPARATOR_LINE.fullmatch(line):
            self._before, self._delimiter = 1, match[1]
            line = next(self._lines, "")
        self._line = line
        self._delimiter = self._delimiter or delimiter_of(line)
        has_blank = _PICTURE_AND_BLANK.match(line) is not None and self._delimiter == ","
        self._has_blanks = has_blank or self._delimiter == " "
        self.first = [cell.strip() for cell in next(self._parse([line]), [])]

    def rows(self, has_header: bool) -> Iterator[tuple[int, list[str]]]:
        """The lines with their numbers, from 1; without the first, if it is a header."""
        lines = self._lines if has_header else itertools.chain([self._line], self._lines)
        reader = self._parse(lines)
        for cells in reader:
            if any(cells):
                yield reader.line_num + has_header + self._before, cells

    def _parse(self, lines: Iterator[str] | Sequence[str]) -> Any:
        if self._has_blanks:
            lines = (re.sub(r"[\s,]+", " ", line.strip()) for line in lines)
            return csv.reader(lines, delimiter=" ")
        # with a tab as the delimiter, an empty cell is not a blank to be skipped
        return csv.reader(lines, delimiter=self._delimiter, skipinitialspace=self._delimiter != "\t")


def delimiter_of(line: str) -> str:
    """The most frequent of ; tab and , in a line of a csv, not the commas if equal: they are decimal. Without any,
    a blank."""
    found = max(";\t,", key=line.count)
    return found if found in line else " "


@contextlib.contextmanager
def open_csv(path: Path) -> Iterator[io.TextIOWrapper]:
    """The text of a csv: UTF-8, or UTF-16 with a mark."""
    with open_regular(path) as stream:
        encoding = "utf-16" if stream.read(2) in UTF16_MARKS else "utf-8-sig"
        stream.seek(0)
        yield io.TextIOWrapper(stream, encoding, errors="replace", newline="")


def _lines(text: io.TextIOWrapper) -> Iterator[str]:
    """Raises csv.Error for a line that is too long: it might be a gigabyte."""
    while line := text.readline(MAX_LINE_CHARACTERS):
        if len(line) == MAX_LINE_CHARACTERS:
            raise csv.Error(f"a line of over {MAX_LINE_CHARACTERS:,} characters")
        yield line


def _row(name: str, position: int, values: Mapping[str, str], key: str | None, *, is_date: bool) -> RecordedRow:
    """A row; `key` is that of its time."""
    row = RecordedRow(name, position=position)
    row.steering, row.throttle, row.brake, row.speed = (
        _number(values[key]) if key in values else math.nan for key in _NUMBERS
    )
    if key is not None:
        row.time = _iso_ns(values[key]) if is_date else _time(values[key])
        if row.time is None:
            row.problem = "rows whose time is not a number" if not is_date else "rows whose time is not a date"
    cameras = {camera: values[camera] for camera in CAMERAS if values.get(camera)}
    if "camera" in values:
        row.camera = camera_named(values["camera"])
        if row.camera is None:
            row.problem = row.problem or "rows of an unknown camera (expected left, center or right)"
        cameras = dict(zip([row.camera or "center"], cameras.values(), strict=False))
    row.pictures = cameras
    if not cameras:
        row.problem = row.problem or "rows that name no picture"
    return row


def _number(text: str) -> float:
    try:
        return read_number(text)
    except ValueError:
        return math.nan


def _time(text: str) -> float | None:
    """Whole numbers keep all digits; None for other text."""
    exact = whole_number(text, 19)
    if exact is not None:
        return exact
    number = _number(text)
    return None if math.isnan(number) else number


def _iso_ns(text: str) -> int | None:
    """A date with a time as in ISO 8601, without a zone in UTC; None for other text."""
    if not _DATE.match(text):
        return None
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    aware = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return (aware - _EPOCH) // timedelta(microseconds=1) * 1000


def _names_cameras(position: int, rows: Sequence[Sequence[str]]) -> bool:
    """True if a column names different cameras, and nothing else."""
    cameras = {camera_named(row[position]) if position < len(row) else None for row in rows}
    return None not in cameras and len(cameras) > 1
