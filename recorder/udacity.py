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
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from common import Skipped
from recorder.errors import RecordingError
from recorder.topics import CAMERAS, Camera

CSV_NAME = "driving_log.csv"

_PATHS = re.compile(r'^\s*"?(.*?\.jpe?g)"?\s*,\s*"?(.*?\.jpe?g)"?\s*,\s*"?(.*?\.jpe?g)"?\s*,(.*)$', re.IGNORECASE)
_TIME_IN_NAME = re.compile(r"_(\d{4})_(\d\d)_(\d\d)_(\d\d)_(\d\d)_(\d\d)_(\d{3})\.jpe?g$", re.IGNORECASE)
_HEADER = re.compile(r'^\s*"?center"?\s*,', re.IGNORECASE)
_WHOLE = re.compile(r"-?(0|[1-9]\d*)$")
_FRACTION = re.compile(r"\d*[1-9]([eE][+-]?\d+)?$")  # the simulator prints no trailing zeros
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
    pictures: dict[Camera, Path]  # those that exist


@dataclass(frozen=True)
class Recording:
    folder: Path
    rows: list[Row]
    skipped: Skipped


def read_recording(folder: Path) -> Recording:
    """Read the csv of `folder` and find its pictures; no picture is opened.

    Raises RecordingError if there is no csv, no usable row, or not a single picture.
    """
    csv = folder / CSV_NAME
    if not folder.is_dir():
        raise RecordingError(f"{folder}: no such folder; give the folder that holds {CSV_NAME} and IMG/")
    if not csv.is_file():
        raise RecordingError(f"{folder}: no {CSV_NAME} in it; give the folder that the simulator recorded into")
    skipped = Skipped()
    pictures = _find_pictures(folder, skipped)
    rows: list[Row] = []
    used: set[str] = set()
    seen: set[tuple[str, str, str]] = set()
    for line, text in enumerate(_lines(csv), start=1):
        if not text.strip() or _HEADER.match(text):
            continue
        try:
            names, rest = _names(text)
            if names in seen:
                raise ValueError(
                    "the pictures of an earlier row"
                )  # twice the same, it could be on both sides of a split
            seen.add(names)
            used.update(names)
            values = _values(rest, rows[-1].speed_mph if rows else 0.0)
            time_ns = _time_ns(names)
        except ValueError as error:
            skipped.add(f"rows with {error}", f"line {line}")
            continue
        found: dict[Camera, Path] = {}
        for camera, name in zip(CAMERAS, names, strict=True):
            if name in pictures:
                found[camera] = pictures[name]
            else:
                skipped.add("pictures that a row names but no folder has", name)
        rows.append(Row(line, time_ns, *values, found))
    if not rows:
        raise RecordingError(f"{csv}: no usable row{_because(skipped)}")
    if not any(row.pictures for row in rows):
        raise RecordingError(
            f"{csv}: none of its pictures is there; they are looked for in IMG/, in {folder.name}/ and in ../IMG/"
        )
    for name in sorted(pictures.keys() - used):
        skipped.add("pictures without a row", name)
    return Recording(folder, rows, skipped)


def _lines(csv: Path) -> list[str]:
    # Bytes split at \n, \r\n and \r only. Foreign encodings do not matter: what counts of a path is the file's
    # name, and undecodable bytes in that are kept as the file system keeps them.
    return [os.fsdecode(line) for line in csv.read_bytes().removeprefix(b"\xef\xbb\xbf").splitlines()]


def _names(text: str) -> tuple[tuple[str, str, str], str]:
    """The file names (centre, left, right) of a line, and what follows them; ValueError says what is wrong."""
    match = _PATHS.match(text)
    if match is None:
        raise ValueError("fewer than three pictures, or cut off")
    center, left, right = (re.split(r"[/\\]", path)[-1].strip() for path in match.group(1, 2, 3))
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
            if abs(steering) <= 1 and 0 <= throttle <= 1 and 0 <= brake <= 1 and speed_mph > -100:
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


def _find_pictures(folder: Path, skipped: Skipped) -> dict[str, Path]:
    """JPEG files by name: in IMG/ beside the csv, in the csv's folder, in ../IMG; the first wins.

    A link that leaves the recording is not followed: a recording is somebody else's data.
    """
    pictures: dict[str, Path] = {}
    root = folder.resolve()
    for place, allowed in ((root / "IMG", root), (root, root), (root.parent / "IMG", root.parent / "IMG")):
        if not place.is_dir() or not place.resolve().is_relative_to(allowed):
            continue
        for entry in os.scandir(place):
            if not entry.name.lower().endswith((".jpg", ".jpeg")) or entry.name in pictures:
                continue
            if entry.is_symlink() and not Path(entry.path).resolve().is_relative_to(allowed):
                skipped.add("pictures that are links out of the recording", entry.name)
            elif entry.is_file():
                pictures[entry.name] = Path(entry.path)
    return pictures


def _because(skipped: Skipped) -> str:
    return "".join(f"; {line}" for line in skipped.lines(most_names=3))
