"""The rows of `driving_log.csv`, as training mode writes them on machines of any country.

    IMG/center_2024_07_13_14_30_16_000.jpg,IMG/left_....jpg,IMG/right_....jpg,steering,throttle,brake,speed

The oddities of published recordings are accepted: mixed separators, a spreadsheet's semicolons or tabs, foreign
paths, a header, scientific notation, decimal commas, a last row that is cut off. Simulators with one camera leave
the other two paths empty. A row without four numbers after its pictures is skipped.
"""

from __future__ import annotations

import csv
import itertools
import math
import os
import re
import string
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from typing import Final

from recorder.errors import RecordingError
from recorder.sources.imported_rows import RecordedRow
from simulator.protocol.udacity_writer import CSV_CAMERAS

MAX_LINE_BYTES: Final = 1 << 16  # a longer line is not a row

# Spaces and quotes before a path are stripped later: if they also matched here, a line of spaces would never end.
_PATH = r'(.*?\.jpe?g)"?\s*,'
_PATH_OR_NONE = r'([\s"]*+(?=,)|.*?\.jpe?g)"?\s*,'
_PATHS = re.compile(f"{_PATH}{_PATH_OR_NONE}{_PATH_OR_NONE}(.*)$", re.IGNORECASE)
_TIME_IN_NAME = re.compile(
    r"_(\d{4})_(\d\d)_(\d\d)_(\d\d)_(\d\d)_(\d\d)_(\d{3})\.jpe?g$", re.IGNORECASE | re.ASCII
)
_COLUMNS = ("center", "left", "right", "steering", "throttle", "brake", "speed")
_HEADER = re.compile(rf'^\s*"?({"|".join(_COLUMNS)})"?\s*[,;\t]', re.IGNORECASE)
_NAME_PADDING = string.whitespace + '"'
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
UTF16_MARKS: Final = (b"\xff\xfe", b"\xfe\xff")  # PowerShell's `>` writes UTF-16
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_BUDDHIST_YEARS: Final = range(2500, 2700)
_OTHER_YEARS: Final = range(1300, 1500)  # Persian, Hijri
_LAST = datetime(2262, 1, 1, tzinfo=UTC)  # the last year whose nanoseconds fit into 63 bits

# .NET writes numbers as in its user's country. Apart from decimal commas, there are "0/5" (Persian in Mono and
# .NET Framework) and ICU's signs: U+066B for the point, U+2212 for the minus, and marks of the direction of
# writing.
_LOCALIZED = str.maketrans({"/": ".", "\u066b": ".", "\u2212": "-", "\u200e": "", "\u200f": "", "\u061c": ""})
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_TRAILING_MINUS = re.compile(r"([0-9.]+)-")  # 0.5-: Arabic and Persian, with a fixed number of decimals
_WHOLE = re.compile(r"-?(0|[1-9][0-9]*)")
_FRACTION = re.compile(r"[0-9]*[1-9]([eE][+-]?[0-9]+)?")  # the simulator prints no trailing zeros

_Values = tuple[float, float, float, float]


class RowReader:
    """Reads rows from a csv's lines, given in order."""

    def __init__(self) -> None:
        self._values = _ValueReader()
        self._calendar = _Calendar()
        self._position = -1  # of the row, counting unusable rows: they took time, too

    @property
    def is_of_another_calendar(self) -> bool:
        """True if a picture's name had a date that cannot be converted; times then begin in 1970."""
        return self._calendar.first_day is not None

    def read(self, line: int, content: bytes) -> RecordedRow | None:
        """The row of this line (numbered from 1), with its time in nanoseconds and the names of its pictures'
        files; None for a blank line or a header.

        The time is that in a picture's name, read as UTC: the simulator writes local time without a zone. Raises
        RecordingError for a csv in UTF-16, and for a header with another order.
        """
        if line == 1 and content.startswith(UTF16_MARKS):
            raise RecordingError("driving_log.csv: its text is UTF-16; save it as UTF-8")
        name = f"line {line}"
        if len(content) > MAX_LINE_BYTES:
            self._position += 1
            return RecordedRow(name, problem=f"rows with more than {MAX_LINE_BYTES:,} bytes")
        # Foreign encodings do not matter: only the file's name counts, and its undecodable bytes are kept as the
        # file system keeps them.
        text = os.fsdecode(content.removeprefix(_BYTE_ORDER_MARK) if line == 1 else content)
        if not text.strip():
            return None
        if _HEADER.match(text):
            _check_order(line, text)
            return None
        self._position += 1
        row = RecordedRow(name, position=self._position)
        try:
            names, rest = _names(text)
            row.pictures = {camera: name for camera, name in zip(CSV_CAMERAS, names, strict=True) if name}
            row.time = self._calendar.time_in(names)
            row.steering, row.throttle, row.brake, row.speed = self._values.read(rest)
        except ValueError as error:
            row.problem = f"rows with {error}"
        return row


class _ValueReader:
    """Reads steering, throttle, brake and speed. If a row is ambiguous, earlier rows decide."""

    def __init__(self) -> None:
        self._speed_mph = 0.0
        self._has_points = False  # a row had decimal points
        self._has_commas = False  # a row had commas that can only be decimal commas

    def read(self, text: str) -> _Values:
        """The values at the end of a line. Raises ValueError with the row's error."""
        text = text.strip().rstrip(", ").translate(_LOCALIZED)
        if text.count('"') % 2:  # the other quote is before the paths, or was cut off
            text = text.replace('"', "")
        values = self._read(text)
        self._speed_mph = values[3]
        return values

    def _read(self, text: str) -> _Values:
        """Read values with decimal points, or with decimal commas: then four values have 4 to 8 cells."""
        cells = [cell.strip() for cell in next(csv.reader([text], skipinitialspace=True), [])]
        if len(cells) < 4:
            raise ValueError("fewer than four values, or cut off")
        spaced = text.split(", ")
        is_unambiguous = "." in text or '"' in text or len(spaced) > 4  # which commas are decimal
        if not is_unambiguous and len(cells) > 4 == len(spaced):
            cells = spaced  # commas without a space are decimal
        if len(cells) == 4:
            values = _four_numbers(cells)
            self._has_points |= "." in text
            self._has_commas |= "," in "".join(cells)
            return values
        # Perhaps a column of whole numbers follows, or a value has a decimal comma; files with points have none.
        if is_unambiguous or (len(cells) == 5 and self._has_points and not self._has_commas):
            raise ValueError("more than four values")
        readings = list(_decimal_comma_readings(cells))
        if not readings:
            raise ValueError("values that are not four numbers")
        self._has_commas |= len(cells) > 5
        # The most plausible reading: a speed is hardly ever a whole number, and does not jump from row to row. A
        # brake is nearly always 0 or 1.
        return min(readings, key=lambda r: (r[3].is_integer(), abs(r[3] - self._speed_mph), not r[2].is_integer()))


def _four_numbers(cells: list[str]) -> _Values:
    steering, throttle, brake, speed_mph = map(read_number, cells)
    if not all(map(math.isfinite, (steering, throttle, brake, speed_mph))):
        raise ValueError("a value that is not finite")
    return steering, throttle, brake, speed_mph


def read_number(text: str) -> float:
    """A number as .NET prints it in any country. Other forms of Python are refused: 1_0, nan, digits of other
    scripts. Raises ValueError."""
    text = text.translate(_LOCALIZED).replace(",", ".")
    if match := _TRAILING_MINUS.fullmatch(text):
        text = f"-{match[1]}"
    if not _NUMBER.fullmatch(text):
        raise ValueError("a value that is not a number")
    return float(text)


def _decimal_comma_readings(cells: list[str]) -> Iterator[_Values]:
    """All readings of `cells` as four plausible numbers, some of them split at a decimal comma."""
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


def _check_order(line: int, header: str) -> None:
    names = (name.strip(_NAME_PADDING).lower() for name in re.split(r"[,;\t]", header))
    columns = list(dict.fromkeys(name for name in names if name in _COLUMNS))
    if columns != sorted(columns, key=_COLUMNS.index):
        raise RecordingError(
            f"driving_log.csv: line {line} names the columns {', '.join(columns)}; expected the order"
            f" {', '.join(_COLUMNS)}. Sort the columns, or name them with --columns"
        )


def _names(text: str) -> tuple[tuple[str, str, str], str]:
    """The file names (centre, left, right) of a line, and the rest. Raises ValueError with the row's error."""
    match = _PATHS.match(text) or _PATHS.match(_with_commas(text))
    if match is None:
        raise ValueError("fewer than three columns of pictures, or cut off")
    center, left, right = (re.split(r"[/\\]", path)[-1].strip(_NAME_PADDING) for path in match.group(1, 2, 3))
    return (center, left, right), match.group(4)


def _with_commas(text: str) -> str:
    """A line with semicolons or tabs, as one with commas and with quotes: values may have decimal commas."""
    separator = max(";\t", key=text.count)
    cells = text.replace('"', "").rstrip(separator + string.whitespace).split(separator)
    return ",".join(f'"{cell.strip()}"' for cell in cells)


class _Calendar:
    """Reads the times in pictures' names. The simulator writes years and months of its user's calendar."""

    def __init__(self) -> None:
        self.first_day: int | None = None

    def time_in(self, names: Sequence[str]) -> int | None:
        """The time in one of the names, in nanoseconds; None without one. Raises ValueError for no time at all."""
        match = next((match for name in names if (match := _TIME_IN_NAME.search(name))), None)
        if match is None:
            return None
        year, month, day, hour, minute, second, ms = map(int, match.groups())
        if year in _BUDDHIST_YEARS:
            year -= 543
        if hour > 23 or minute > 59 or second > 59:
            raise ValueError("a time in their pictures' names that no clock shows")
        within_day = timedelta(hours=hour, minutes=minute, seconds=second, milliseconds=ms)
        if year in _OTHER_YEARS and 1 <= month <= 12 and 1 <= day <= 32:
            # lunar and Persian months: the days between two months are not counted right, but they are a pause
            days = (year * 12 + month) * 32 + day
            self.first_day = days if self.first_day is None else self.first_day
            since = timedelta(days=max(days - self.first_day, 0)) + within_day
        else:
            try:
                since = datetime(year, month, day, tzinfo=UTC) + within_day - _EPOCH
            except ValueError:
                raise ValueError("a time in their pictures' names that no log can hold") from None
            if not timedelta(0) <= since < _LAST - _EPOCH:
                raise ValueError("a time in their pictures' names that no log can hold")
        return since // timedelta(microseconds=1) * 1000
