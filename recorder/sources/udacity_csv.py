"""The rows of `driving_log.csv`, as training mode writes them on any machine, in any country.

    IMG/center_2024_07_13_14_30_16_000.jpg,IMG/left_....jpg,IMG/right_....jpg,steering,throttle,brake,speed

People have published such recordings from many machines, and every oddity seen in them is taken: mixed separators,
foreign paths, a header, scientific notation, decimal commas, a last row cut off. Simulators with one camera leave
the other two paths empty. A row that does not hold four numbers behind its pictures is not used.
"""

from __future__ import annotations

import csv
import itertools
import math
import os
import re
import string
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Final

from common import Skipped
from recorder.errors import RecordingError
from recorder.sources.frame_rate import check_rate

MAX_LINE_BYTES: Final = 1 << 16  # a longer line is no row of anything

# Spaces and quotes before a path are stripped later: matched here as well, a line of spaces would take for ever.
_PATH = r'(.*?\.jpe?g)"?\s*,'
_PATH_OR_NONE = r'([\s"]*+(?=,)|.*?\.jpe?g)"?\s*,'
_PATHS = re.compile(f"{_PATH}{_PATH_OR_NONE}{_PATH_OR_NONE}(.*)$", re.IGNORECASE)
_TIME_IN_NAME = re.compile(
    r"_(\d{4})_(\d\d)_(\d\d)_(\d\d)_(\d\d)_(\d\d)_(\d{3})\.jpe?g$", re.IGNORECASE | re.ASCII
)
_HEADER = re.compile(r'^\s*"?center"?\s*,', re.IGNORECASE)
_NAME_PADDING = string.whitespace + '"'
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LAST = datetime(2262, 1, 1, tzinfo=UTC)  # the last year whose nanoseconds fit into 63 bits

# .NET writes a number as its user's country does. Besides the comma: 0/5 (Persian in Mono and .NET Framework), and
# where it uses ICU, U+066B for the point, U+2212 for the minus, and marks of the direction of writing.
_LOCALIZED = str.maketrans({"/": ".", "\u066b": ".", "\u2212": "-", "\u200e": "", "\u200f": "", "\u061c": ""})
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_TRAILING_MINUS = re.compile(r"([0-9.]+)-")  # 0.5-: Arabic and Persian, with a fixed number of decimals
_WHOLE = re.compile(r"-?(0|[1-9][0-9]*)")
_FRACTION = re.compile(r"[0-9]*[1-9]([eE][+-]?[0-9]+)?")  # the simulator prints no trailing zeros

_Values = tuple[float, float, float, float]


@dataclass(frozen=True)
class Row:
    """One line of the csv that can be used."""

    line: int  # in the csv, from 1
    time_ns: int  # of the picture's name, taken as UTC: the simulator writes local time and names no zone
    steering: float
    throttle: float
    brake: float
    speed_mph: float
    names: tuple[str, str, str]  # of the pictures' files, in the order of `CSV_CAMERAS`; "" where it names none


class RowReader:
    """Makes rows of a csv's lines, given in their order; what cannot be used goes to `skipped`.

    With `rate_hz` the rows are so many a second, from 1970 on, whatever their pictures are called.
    """

    def __init__(self, skipped: Skipped, rate_hz: float | None = None) -> None:
        """Raises RecordingError for a rate that no camera has."""
        check_rate(rate_hz)
        self.named = set[str]()  # every picture that a line names
        self._skipped = skipped
        self._earlier_rows = set[tuple[str, str, str]]()  # the names of their pictures
        self._values = _ValueReader()
        self._rate_hz = rate_hz
        self._position = -1  # of the row, counting those that cannot be used: their time passed as well
        self._is_first = True

    def read(self, line: int, content: bytes) -> Row | None:
        """The row of this line, the first being number 1, or None if there is none in it.

        Raises RecordingError if the names of the first row's pictures hold their time, but a rate was given.
        """
        if len(content) > MAX_LINE_BYTES:
            self._position += 1
            self._skipped.add(f"rows with more than {MAX_LINE_BYTES:,} bytes", f"line {line}")
            return None
        # Foreign encodings do not matter: what counts of a path is the file's name, and undecodable bytes in that
        # are kept as the file system keeps them.
        text = os.fsdecode(content.removeprefix(_BYTE_ORDER_MARK) if line == 1 else content)
        if not text.strip() or _HEADER.match(text):
            return None
        self._position += 1
        try:
            names, rest = _names(text)
            if names in self._earlier_rows:  # twice in a log, it could be on both sides of a split
                raise ValueError("the pictures of an earlier row")
            self._earlier_rows.add(names)
            self.named.update(filter(None, names))
            row = Row(line, self._time_ns(names), *self._values.read(rest), names)
        except ValueError as error:
            self._skipped.add(f"rows with {error}", f"line {line}")
            return None
        self._is_first = False
        return row

    def _time_ns(self, names: tuple[str, str, str]) -> int:
        name_time_ns = _time_in(names)
        if self._rate_hz is not None:
            if self._is_first and name_time_ns is not None:
                raise RecordingError("--rate: the pictures' names have their times; leave it out")
            return round(self._position * 1e9 / self._rate_hz)
        if name_time_ns is None:
            raise ValueError("no time in their pictures' names (--rate 20 takes them as 20 a second)")
        return name_time_ns


class _ValueReader:
    """Reads steering, throttle, brake and speed; where a row is ambiguous, the rows before it decide."""

    def __init__(self) -> None:
        self._speed_mph = 0.0
        self._has_points = False  # some row had decimal points
        self._has_commas = False  # ... or commas that can only be decimal ones

    def read(self, text: str) -> _Values:
        """The values at the end of a line. Raises ValueError with the row's fault."""
        text = text.strip().rstrip(", ").translate(_LOCALIZED)
        if text.count('"') % 2:  # its other one is before the paths, or was cut off
            text = text.replace('"', "")
        values = self._read(text)
        self._speed_mph = values[3]
        return values

    def _read(self, text: str) -> _Values:
        """Read values with decimal points, or with decimal commas: then four values are 4 to 8 cells."""
        cells = [cell.strip() for cell in next(csv.reader([text], skipinitialspace=True), [])]
        if len(cells) < 4:
            raise ValueError("fewer than four values, or cut off")
        spaced = text.split(", ")
        is_unambiguous = "." in text or '"' in text or len(spaced) > 4  # what is a cell, and what a decimal comma
        if not is_unambiguous and len(cells) > 4 == len(spaced):
            cells = spaced  # a comma without a space is then a decimal comma
        if len(cells) == 4:
            values = _four_numbers(cells)
            self._has_points |= "." in text
            self._has_commas |= "," in "".join(cells)
            return values
        # A column of whole numbers may follow, or one value have a decimal comma: files with points have none.
        if is_unambiguous or (len(cells) == 5 and self._has_points and not self._has_commas):
            raise ValueError("more than four values")
        readings = list(_decimal_comma_readings(cells))
        if not readings:
            raise ValueError("values that are not four numbers")
        self._has_commas |= len(cells) > 5
        # Where several readings are possible: a speed is hardly ever a whole number, it does not jump from one
        # row to the next, and a brake is nearly always 0 or 1.
        return min(readings, key=lambda r: (r[3].is_integer(), abs(r[3] - self._speed_mph), not r[2].is_integer()))


def _four_numbers(cells: list[str]) -> _Values:
    steering, throttle, brake, speed_mph = map(_number, cells)
    if not all(map(math.isfinite, (steering, throttle, brake, speed_mph))):
        raise ValueError("a value that is not finite")
    return steering, throttle, brake, speed_mph


def _number(text: str) -> float:
    """A number as .NET prints it; not all that Python takes for one: 1_0, nan, digits of other scripts."""
    text = text.replace(",", ".")
    if match := _TRAILING_MINUS.fullmatch(text):
        text = f"-{match[1]}"
    if not _NUMBER.fullmatch(text):
        raise ValueError("a value that is not a number")
    return float(text)


def _decimal_comma_readings(cells: list[str]) -> Iterator[_Values]:
    """Every way to read `cells` as four plausible numbers, some of them split at a decimal comma."""
    if not 4 < len(cells) <= 8:
        return
    for is_split in itertools.product((False, True), repeat=4):
        if sum(is_split) != len(cells) - 4:
            continue
        numbers, rest = [], iter(cells)
        for split in is_split:
            whole, fraction = next(rest), next(rest) if split else ""
            if not _WHOLE.fullmatch(whole) or (split and not _FRACTION.fullmatch(fraction)):
                break
            numbers.append(float(f"{whole}.{fraction}"))
        else:
            steering, throttle, brake, speed_mph = numbers
            if abs(steering) <= 1 and 0 <= throttle <= 1 and 0 <= brake <= 1 and -100 < speed_mph < math.inf:
                yield steering, throttle, brake, speed_mph


def _names(text: str) -> tuple[tuple[str, str, str], str]:
    """The file names (centre, left, right) of a line, and what follows them. Raises ValueError with its fault."""
    match = _PATHS.match(text)
    if match is None:
        raise ValueError("fewer than three columns of pictures, or cut off")
    center, left, right = (re.split(r"[/\\]", path)[-1].strip(_NAME_PADDING) for path in match.group(1, 2, 3))
    return (center, left, right), match.group(4)


def _time_in(names: tuple[str, str, str]) -> int | None:
    """The time in one of the names. Raises ValueError if no log can hold it."""
    has_time = False
    for name in names:
        if match := _TIME_IN_NAME.search(name):
            has_time = True
            year, month, day, hour, minute, second, ms = map(int, match.groups())
            try:
                moment = datetime(year, month, day, hour, minute, second, ms * 1000, tzinfo=UTC)
            except ValueError:
                continue
            if _EPOCH <= moment < _LAST:
                return (moment - _EPOCH) // timedelta(microseconds=1) * 1000
    if has_time:
        raise ValueError("a time in their pictures' names that no log can hold")
    return None
