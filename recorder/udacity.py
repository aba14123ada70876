"""Reading what the simulator's training mode writes: `driving_log.csv` and a folder of pictures.

People have published such recordings from many machines, and every oddity seen in them is taken: mixed
separators, any line ends, foreign paths, a header, scientific notation, decimal commas, missing pictures,
several drives in one file, a last row cut off. What cannot be used is named in `Recording.skipped`.
"""

from __future__ import annotations

import itertools
import math
import os
import re
import string
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from common import Skipped
from recorder.errors import RecordingError

CSV_NAME = "driving_log.csv"
MISSING = "pictures that a row names but no folder has"
WITHOUT_ROW = "pictures without a row"

# Spaces and quotes before a path are stripped later: matched here as well, a line of spaces would take for ever.
_PATHS = re.compile(r'(.*?\.jpe?g)"?\s*,(.*?\.jpe?g)"?\s*,(.*?\.jpe?g)"?\s*,(.*)$', re.IGNORECASE)
_TIME_IN_NAME = re.compile(r"_(\d{4})_(\d\d)_(\d\d)_(\d\d)_(\d\d)_(\d\d)_(\d{3})\.jpe?g$", re.IGNORECASE)
_HEADER = re.compile(r'^\s*"?center"?\s*,', re.IGNORECASE)
_AROUND_A_NAME = string.whitespace + '"'
_WHOLE = re.compile(r"-?(0|[1-9]\d*)$")
_FRACTION = re.compile(r"\d*[1-9]([eE][+-]?\d+)?$")  # the simulator prints no trailing zeros
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
    folder: Path
    rows: list[Row]
    pictures: dict[str, str]  # file name -> path, of all that exist
    skipped: Skipped


class RowReader:
    """Makes rows of a csv's lines, given in their order; what cannot be used goes to `skipped`."""

    def __init__(self, skipped: Skipped) -> None:
        self.named: set[str] = set()  # every picture that a line names
        self._skipped = skipped
        self._seen: set[tuple[str, str, str]] = set()
        self._speed_mph = 0.0

    def read(self, line: int, content: bytes) -> Row | None:
        """The row of this line, the first being number 1, or None if there is none in it."""
        # Foreign encodings do not matter: what counts of a path is the file's name, and undecodable bytes in that
        # are kept as the file system keeps them.
        text = os.fsdecode(content.removeprefix(_BYTE_ORDER_MARK) if line == 1 else content)
        if not text.strip() or _HEADER.match(text):
            return None
        try:
            names, rest = _names(text)
            if names in self._seen:  # twice in a log, it could be on both sides of a split
                raise ValueError("the pictures of an earlier row")
            self._seen.add(names)
            self.named.update(names)
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
        self.paths: dict[str, str] = {}  # by file name
        self._folder = folder
        self._skipped = skipped
        self._links: set[str] = set()

    def places(self) -> list[Path]:
        """The folders that there are to look into."""
        return [place for place, root in self._places() if place.is_dir() and is_inside(place, root)]

    def look_into(self, place: Path) -> None:
        """Take the pictures of one of the `places` into `paths`."""
        with os.scandir(place) as entries:
            for entry in entries:
                if entry.name in self.paths or not entry.name.lower().endswith((".jpg", ".jpeg")):
                    continue
                if entry.is_symlink() and not self.is_inside(entry.path):
                    if entry.path not in self._links:
                        self._links.add(entry.path)
                        self._skipped.add("pictures that are links out of the recording", entry.name)
                elif entry.is_file():
                    self.paths[entry.name] = entry.path

    def is_inside(self, path: str) -> bool:
        """Whether a picture is, all links followed, where it was looked for."""
        return any(is_inside(Path(path), root) for place, root in self._places() if place == Path(path).parent)

    def _places(self) -> tuple[tuple[Path, Path], ...]:
        """Each place with the folder that no link may leave."""
        root = Path(os.path.realpath(self._folder))
        above = root.parent / "IMG"
        return (root / "IMG", root), (root, root), (above, above)


def read_recording(folder: Path) -> Recording:
    """Read the csv of `folder` and find its pictures; no picture is opened.

    Raises RecordingError if there is no csv, no usable row, or not a single picture.
    """
    csv = folder / CSV_NAME
    skipped = Skipped()
    try:
        if not folder.is_dir():
            raise RecordingError(f"{folder}: no such folder; give the folder that holds {CSV_NAME} and IMG/")
        check_csv(folder)
        if not csv.is_file():
            raise RecordingError(
                f"{folder}: no {CSV_NAME} in it; give the folder that the simulator recorded into"
            )
        files = PictureFiles(folder, skipped)
        for place in files.places():
            files.look_into(place)
        lines = csv.read_bytes().splitlines()  # of bytes: at \n, \r\n and \r only
    except OSError as error:
        raise RecordingError(f"{error.filename}: cannot be read ({error.strerror})") from None
    reader = RowReader(skipped)
    rows = []
    for line, content in enumerate(lines, start=1):
        row = reader.read(line, content)
        if row is None:
            continue
        rows.append(row)
        for name in row.names:
            if name not in files.paths:
                skipped.add(MISSING, name)
    if not rows:
        raise RecordingError(f"{csv}: no usable row{because(skipped)}")
    if not any(name in files.paths for row in rows for name in row.names):
        raise RecordingError(
            f"{csv}: none of its pictures is there; they are looked for in IMG/, in {folder.name}/ and in ../IMG/"
        )
    for name in sorted(files.paths.keys() - reader.named):
        skipped.add(WITHOUT_ROW, name)
    return Recording(folder, rows, files.paths, skipped)


def check_csv(folder: Path) -> None:
    """Raise RecordingError if the csv of `folder` is a link out of it."""
    csv = folder / CSV_NAME
    if csv.is_symlink() and not is_inside(csv, Path(os.path.realpath(folder))):
        raise RecordingError(
            f"{csv}: a link out of the recording, which is not followed; give a folder of its own"
        )


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
