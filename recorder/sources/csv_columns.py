"""The rows of any csv, whose columns `--columns` names."""

from __future__ import annotations

import contextlib
import csv
import io
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from common import Skipped
from common.car import CAMERAS, Camera
from common.errors import did_you_mean, printable
from common.untrusted import open_regular, whole_number
from recorder.bc_pb2 import VehicleState
from recorder.errors import RecordingError, readable
from recorder.rows.row_quality import GAP_S
from recorder.sources.imported_rows import vehicle_state
from recorder.sources.udacity_csv import UTF16_MARKS

MAX_LINE_CHARACTERS: Final = 100_000
_POSITIONS: Final = frozenset(map(str, range(1, 1000)))
_NUMBERS: Final = ("steering", "throttle", "brake", "speed_mph")
_TIMES: Final = {"time_s": 1e9, "time_ms": 1e6, "time_us": 1e3, "time_ns": 1.0}  # nanoseconds of each unit
_UNITS: Final = dict(zip(_TIMES, ("seconds", "milliseconds", "microseconds", "nanoseconds"), strict=True))
_MIN_STEP_NS: Final = 5e6  # more than 200 pictures a second are less likely than a wrong unit
KEYS: Final = ("image", *CAMERAS, *_NUMBERS, *_TIMES)


@dataclass(frozen=True)
class CsvRow:
    line: int
    index: int  # in the file, counting unusable rows
    pictures: Mapping[Camera, str]  # as the csv names them
    state: VehicleState
    time_ns: int | None


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
        return cls(names)

    @property
    def has_times(self) -> bool:
        return bool(_TIMES.keys() & self.names.keys())

    def likely_unit(self, time_ns: NDArray[np.int64]) -> str:
        """A question, if the distances between the rows' times (N,) suggest another unit; else ""."""
        given = next(iter(_TIMES.keys() & self.names.keys()))
        steps_ns = np.diff(np.sort(time_ns))
        if not (steps_ns > 0).any():
            return ""
        step_ns = float(np.median(steps_ns[steps_ns > 0]))
        usual = [key for key in _TIMES if _MIN_STEP_NS <= step_ns / _TIMES[given] * _TIMES[key] <= GAP_S * 1e9]
        if not usual or given in usual:
            return ""
        return f"--columns: rows are {step_ns / 1e9:g} s apart; {self._question(usual[0])}, with --force"

    def _question(self, key: str) -> str:
        name = next(self.names[given] for given in _TIMES if given in self.names)
        return f"is {printable(name)!r} in {_UNITS[key]}? Then give {key}={printable(name)}"

    def rows(self, path: Path, scale: float, skipped: Skipped) -> Iterator[CsvRow]:
        """The usable rows of a csv, with steering multiplied by `scale`.

        The delimiter is that of `delimiter_of`. With ; and tab, numbers may have decimal commas. The text is
        UTF-8, or UTF-16 with a mark. Raises RecordingError if the csv cannot be read, or lacks a column.
        """
        try:
            with readable(path), open_csv(path) as text:
                yield from self._rows(path, text, scale, skipped)
        except csv.Error as error:
            raise RecordingError(f"{path}: not a csv ({error})") from None

    def _rows(self, path: Path, text: io.TextIOWrapper, scale: float, skipped: Skipped) -> Iterator[CsvRow]:
        lines = _lines(text)
        first = next(lines, "")
        delimiter = delimiter_of(first)
        header = [name.strip() for name in next(csv.reader([first], delimiter=delimiter), [])]
        at = self._positions(path, header)
        has_header = at is not None
        if at is None:
            at = {key: int(name) - 1 for key, name in self.names.items()}
        rest = lines if has_header else itertools.chain([first], lines)
        reader = csv.reader(rest, delimiter=delimiter)
        for index, cells in enumerate(filter(any, reader)):
            line = reader.line_num + has_header
            row = self._row(line, index, cells, at, scale, delimiter != ",")
            if isinstance(row, str):
                skipped.add(row, f"line {line}")
            else:
                yield row

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

    def _row(
        self, line: int, index: int, cells: Sequence[str], at: Mapping[str, int], scale: float, has_comma: bool
    ) -> CsvRow | str:
        """A row, or the reason why it cannot be used."""
        values = {key: cells[position].strip() if position < len(cells) else "" for key, position in at.items()}
        numbers = {
            key: _number(values[key].replace(",", ".") if has_comma else values[key])
            for key in (*_NUMBERS, *_TIMES)
            if key in values
        }
        if not math.isfinite(numbers["steering"]):
            return "rows whose steering is not a number"
        time_ns: int | None = None
        for key in _TIMES.keys() & values.keys():  # at most one
            if math.isnan(numbers[key]):
                return "rows whose time is not a number"
            time_ns = _time_ns(key, values[key], numbers[key])
            if time_ns is None:
                held_by = next((unit for unit in _TIMES if _time_ns(unit, values[key], numbers[key])), "")
                hint = f" ({self._question(held_by)})" if held_by else ""
                return f"rows with a time that no log can hold{hint}"
        pictures = {camera: values[camera] for camera in CAMERAS if values.get(camera)}
        if not pictures:
            return "rows that name no picture"
        others = {key: numbers[key] for key in _NUMBERS[1:] if key in numbers}
        return CsvRow(line, index, pictures, vehicle_state(numbers["steering"] * scale, **others), time_ns)


def delimiter_of(first_line: str) -> str:
    """The most frequent of ; tab and , in the first line of a csv; not the commas if equal: they are decimal."""
    return max(";\t,", key=first_line.count)


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


def _number(text: str) -> float:
    """NaN for any other text, also for Python's own forms (1_000, nan)."""
    if not text or not all(character in "0123456789.+-eE" for character in text):
        return math.nan
    try:
        return float(text)
    except ValueError:
        return math.nan


def _time_ns(key: str, text: str, number: float) -> int | None:
    """None for a time that no log can hold."""
    if not 0 <= number * _TIMES[key] <= 2**63:  # also NaN
        return None
    exact = whole_number(text, 19) if key == "time_ns" else None  # a float does not hold all of its digits
    time_ns = round(number * _TIMES[key]) if exact is None else exact
    return time_ns if time_ns < 2**63 else None
