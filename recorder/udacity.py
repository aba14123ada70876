"""Reading what the simulator's training mode writes: `driving_log.csv` and a folder of pictures.

People have published such recordings from many machines, and every oddity seen in them is taken: mixed
separators, any line ends, foreign paths, a header, scientific notation, decimal commas, missing pictures,
several drives in one file, a last row cut off. What cannot be used is named in `Recording.skipped`.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import re
import stat
import string
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from common import Skipped
from common.untrusted import open_regular
from recorder.errors import RecordingError
from recorder.lines import MOST_LINE_BYTES, LineSplitter
from recorder.name_set import NameSet

CSV_NAME: Final = "driving_log.csv"
MOST_CSV_BYTES: Final = 1 << 30  # 200 hours of driving
MOST_PICTURE_BYTES: Final = 1 << 26
MISSING = "pictures that a row names but no folder has"
WITHOUT_ROW = "pictures without a row"

# Spaces and quotes before a path are stripped later: matched here as well, a line of spaces would take for ever.
_PATHS = re.compile(r'(.*?\.jpe?g)"?\s*,(.*?\.jpe?g)"?\s*,(.*?\.jpe?g)"?\s*,(.*)$', re.IGNORECASE)
_TIME_IN_NAME = re.compile(r"_(\d{4})_(\d\d)_(\d\d)_(\d\d)_(\d\d)_(\d\d)_(\d{3})\.jpe?g$", re.IGNORECASE)
_HEADER = re.compile(r'^\s*"?center"?\s*,', re.IGNORECASE)
_AROUND_A_NAME = string.whitespace + '"'
_WHOLE = re.compile(r"-?(0|[1-9]\d*)$")
_FRACTION = re.compile(r"\d*[1-9]([eE][+-]?\d+)?$")  # the simulator prints no trailing zeros
_BLOCK_BYTES: Final = 1 << 16
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LAST = datetime(2262, 1, 1, tzinfo=UTC)  # the last year whose nanoseconds fit into 63 bits


@dataclass(frozen=True)
class Row:
    """One line of the csv that can be used."""

    line: int  # in the csv, from 1
    time_ns: int  # of the picture's name, taken as UTC: the simulator writes local time and names no zone
    steering: float
    throttle: float
    brake: float
    speed_mph: float
    names: tuple[str, str, str]  # of its pictures' files, in the order of CAMERAS


@dataclass(frozen=True)
class Recording:
    """All of a recording at once: some kilobytes a row."""

    folder: Path
    rows: list[Row]
    pictures: dict[str, str]  # file name -> path, of all that a row names
    skipped: Skipped


class RowReader:
    """Makes rows of a csv's lines, given in their order; what cannot be used goes to `skipped`."""

    def __init__(self, skipped: Skipped) -> None:
        self.named = NameSet()  # every picture that a line names
        self._skipped = skipped
        self._seen = NameSet()
        self._speed_mph = 0.0

    def read(self, line: int, content: bytes) -> Row | None:
        """The row of this line, the first being number 1, or None if there is none in it."""
        if len(content) > MOST_LINE_BYTES:
            self._skipped.add(f"rows with more than {MOST_LINE_BYTES:,} bytes", f"line {line}")
            return None
        # Foreign encodings do not matter: what counts of a path is the file's name, and undecodable bytes in that
        # are kept as the file system keeps them.
        text = os.fsdecode(content.removeprefix(_BYTE_ORDER_MARK) if line == 1 else content)
        if not text.strip() or _HEADER.match(text):
            return None
        try:
            names, rest = _names(text)
            if not self._seen.add(names):  # twice in a log, it could be on both sides of a split
                raise ValueError("the pictures of an earlier row")
            for name in names:
                self.named.add(name)
            values = _values(rest, self._speed_mph)
            row = Row(line, _time_ns(names), *values, names)
        except ValueError as error:
            self._skipped.add(f"rows with {error}", f"line {line}")
            return None
        self._speed_mph = row.speed_mph
        return row


class PictureFiles:
    """The JPEG files of a recording: in IMG/ beside the csv, in the csv's folder, in ../IMG; the first wins.

    A link that leaves the recording is not followed: a recording is somebody else's data.
    """

    def __init__(self, folder: Path, skipped: Skipped) -> None:
        self._folder = folder
        self._skipped = skipped
        self._links = NameSet()  # those that were told

    def places(self) -> list[Path]:
        """The folders that there are to look into."""
        return [place for place, root in self._places() if place.is_dir() and is_inside(place, root)]

    def find(self, name: str, places: list[Path]) -> str | None:
        """Where the picture called `name` is, in the first of `places` that has it."""
        for place in places:
            path = f"{place}/{name}"
            try:
                mode = os.lstat(path).st_mode
            except (OSError, ValueError):
                continue
            if stat.S_ISREG(mode) or (stat.S_ISLNK(mode) and os.path.isfile(path) and self.is_inside(path)):  # noqa: PTH113
                return path
        return None

    def names_in(self, place: Path) -> Iterator[str]:
        """The pictures in one of the `places`; links that leave the recording are skipped."""
        with os.scandir(place) as entries:
            for entry in entries:
                if not entry.name.lower().endswith((".jpg", ".jpeg")):
                    continue
                if entry.is_symlink() and not self.is_inside(entry.path):
                    if self._links.add(entry.path):
                        self._skipped.add("pictures that are links out of the recording", entry.name)
                elif entry.is_file():
                    yield entry.name

    def skip_without_row(self, named: NameSet) -> None:
        """Skip the pictures that no row names, by name: the order of a folder is another one on every disk."""
        names = {name for place in self.places() for name in self.names_in(place) if name not in named}
        for name in sorted(names):
            self._skipped.add(WITHOUT_ROW, name)

    def is_inside(self, path: str) -> bool:
        """Whether a picture is, all links followed, where it was looked for."""
        return any(is_inside(Path(path), root) for place, root in self._places() if place == Path(path).parent)

    def _places(self) -> tuple[tuple[Path, Path], ...]:
        """Each place with the folder that no link may leave."""
        root = Path(os.path.realpath(self._folder))
        above = root.parent / "IMG"
        return (root / "IMG", root), (root, root), (above, above)


class UdacityFolder:
    """A recording, read from its first line to its last without ever being held as a whole."""

    def __init__(self, folder: Path, skipped: Skipped) -> None:
        """Raises RecordingError if there is no csv in `folder`."""
        self.folder = folder
        self.csv = folder / CSV_NAME
        self._skipped = skipped
        self._files = PictureFiles(folder, skipped)
        with _told(folder):
            if folder.is_file():
                raise RecordingError(f"{folder}: a file; give the folder that holds {CSV_NAME} and IMG/")
            if not folder.is_dir():
                raise RecordingError(f"{folder}: no such folder; give the folder that holds {CSV_NAME} and IMG/")
            if not self.csv.is_file():
                raise RecordingError(
                    f"{folder}: no {CSV_NAME} in it; give the folder that the simulator recorded into"
                )
            check_csv(folder)

    def line_count(self) -> int:
        return sum(1 for _ in self._lines())

    def rows(self) -> Iterator[tuple[Row, tuple[str | None, ...]]]:
        """The rows that can be used, each with the paths of its pictures, None for those that are missing.

        At its end raises RecordingError if there was no row, or not a single picture.
        """
        reader = RowReader(self._skipped)
        row_count = found = 0
        with _told(self.folder):
            places = self._files.places()
            for place in places:
                # of a folder that cannot be read, every picture would seem to be missing
                os.scandir(place).close()
        for line, content in enumerate(self._lines(), start=1):
            row = reader.read(line, content)
            if row is None:
                continue
            row_count += 1
            paths = tuple(self._files.find(name, places) for name in row.names)
            found += sum(path is not None for path in paths)
            yield row, paths
            for name, path in zip(row.names, paths, strict=True):
                if path is None:
                    self._skipped.add(MISSING, name)
        if not row_count:
            if not self.csv.stat().st_size:
                raise RecordingError(f"{self.csv}: an empty file: no drive was recorded")
            raise RecordingError(f"{self.csv}: no usable row{because(self._skipped)}")
        if not found:
            raise RecordingError(
                f"{self.csv}: none of its pictures is there; they are looked for in IMG/, in {self.folder.name}/"
                " and in ../IMG/"
            )
        with _told(self.folder):
            self._files.skip_without_row(reader.named)

    def _lines(self) -> Iterator[bytes]:
        splitter = LineSplitter()
        with _told(self.csv), open_regular(self.csv) as stream:
            while block := stream.read(_BLOCK_BYTES):
                yield from splitter.feed(block)
        if last := splitter.rest():
            yield last


def read_recording(folder: Path) -> Recording:
    """Read the csv of `folder` and find its pictures; no picture is opened.

    Raises RecordingError if there is no csv, no usable row, or not a single picture.
    """
    skipped = Skipped()
    rows, pictures = [], {}
    for row, paths in UdacityFolder(folder, skipped).rows():
        rows.append(row)
        pictures.update({name: path for name, path in zip(row.names, paths, strict=True) if path is not None})
    return Recording(folder, rows, pictures, skipped)


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    """What cannot be read, in one line."""
    try:
        yield
    except OSError as error:
        raise RecordingError(f"{error.filename or path}: cannot be read ({error.strerror})") from None


def check_csv(folder: Path) -> None:
    """Raise RecordingError if the csv of `folder` is a link out of it, or far too large; OSError without one."""
    csv = folder / CSV_NAME
    if csv.is_symlink() and not is_inside(csv, Path(os.path.realpath(folder))):
        raise RecordingError(
            f"{csv}: a link out of the recording, which is not followed; give a folder of its own"
        )
    if csv.stat().st_size > MOST_CSV_BYTES:
        raise RecordingError(f"{csv}: larger than {MOST_CSV_BYTES / 1e9:.0f} GB, which no drive writes")


def is_inside(path: Path, root: Path) -> bool:
    """Whether `path`, all links followed, is below `root`, which is free of links."""
    return Path(os.path.realpath(path)).is_relative_to(root)


def because(skipped: Skipped) -> str:
    """Why nothing was left, for the end of an error."""
    return "".join(f"; {line}" for line in skipped.lines(most_names=3))


def _names(text: str) -> tuple[tuple[str, str, str], str]:
    """The file names (centre, left, right) of a line, and what follows them; ValueError says what is wrong."""
    match = _PATHS.match(text)
    if match is None:
        raise ValueError("fewer than three pictures, or cut off")
    center, left, right = (re.split(r"[/\\]", path)[-1].strip(_AROUND_A_NAME) for path in match.group(1, 2, 3))
    return (center, left, right), match.group(4)


def _values(text: str, speed_before_mph: float) -> tuple[float, float, float, float]:
    """Steering, throttle, brake, speed; with decimal points, or with decimal commas (then 4 to 8 cells)."""
    cells = [cell.strip().strip('"') for cell in text.split(",")]
    while cells and not cells[-1]:
        cells.pop()
    spaced = text.split(", ")
    if len(spaced) == 4 and "." not in text:  # a comma without a space is then a decimal comma
        cells = [cell.strip().strip('"').replace(",", ".") for cell in spaced]
    if len(cells) < 4:
        raise ValueError("fewer than four values, or cut off")
    if len(cells) == 4 or any("." in cell for cell in cells):
        try:
            steering, throttle, brake, speed_mph = (float(cell) for cell in cells[:4])
        except ValueError:
            raise ValueError("a value that is not a number") from None
        if not all(map(math.isfinite, (steering, throttle, brake, speed_mph))):
            raise ValueError("a value that is not finite")
        return steering, throttle, brake, speed_mph
    readings = list(_decimal_comma_readings(cells))
    if not readings:
        raise ValueError("values that are not four numbers")
    # Where several readings are possible: a speed is hardly ever a whole number, it does not jump from one
    # row to the next, and a brake is nearly always 0 or 1.
    return min(readings, key=lambda r: (r[3].is_integer(), abs(r[3] - speed_before_mph), not r[2].is_integer()))


def _decimal_comma_readings(cells: list[str]) -> Iterator[tuple[float, float, float, float]]:
    """Every way to read `cells` as four plausible numbers, some of them split at a decimal comma."""
    if not 4 < len(cells) <= 8:
        return
    for is_split in itertools.product((False, True), repeat=4):
        if sum(is_split) != len(cells) - 4:
            continue
        numbers, rest = [], iter(cells)
        for split in is_split:
            whole, fraction = next(rest), next(rest) if split else ""
            if not _WHOLE.match(whole) or (split and not _FRACTION.match(fraction)):
                break
            numbers.append(float(f"{whole}.{fraction}"))
        else:
            steering, throttle, brake, speed_mph = numbers
            if abs(steering) <= 1 and 0 <= throttle <= 1 and 0 <= brake <= 1 and -100 < speed_mph < math.inf:
                yield steering, throttle, brake, speed_mph


def _time_ns(names: tuple[str, str, str]) -> int:
    for name in names:
        if match := _TIME_IN_NAME.search(name):
            year, month, day, hour, minute, second, ms = map(int, match.groups())
            try:
                moment = datetime(year, month, day, hour, minute, second, ms * 1000, tzinfo=UTC)
            except ValueError:
                continue
            if _EPOCH <= moment < _LAST:
                return (moment - _EPOCH) // timedelta(microseconds=1) * 1000
    raise ValueError("no time in their pictures' names")
