"""Reads a DonkeyCar tub of version 1 or 2: its records, its pictures and its list of deleted records.

Version 2 (donkeycar/parts/tub_v2.py and datastore_v2.py) has `manifest.json` with five JSON lines. The fourth
holds the time of creation, the fifth names the catalogues and the deleted records. Catalogues have one JSON record
a line. Pictures are in `images/`.

Version 1 (donkeycar/parts/datastore.py, up to release 3) has `meta.json`, a `record_N.json` for each record,
pictures in the same folder, and `exclude.json` with the numbers of deleted records.

A tub is untrusted. Only the file names of paths are used. Links out of the tub are not followed, except `images`
itself: users may keep the pictures elsewhere.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from common import Skipped
from common.untrusted import read_bounded
from recorder.errors import RecordingError, readable
from recorder.log.session_car import Car
from recorder.mcap.message_index import LAST_TIME_NS
from recorder.sources.imported_rows import FROM_1970, RawRecording, RecordedRow, recording_metadata
from recorder.sources.picture_folder import PictureFolder

MANIFEST, META, EXCLUDED, IMAGES = "manifest.json", "meta.json", "exclude.json", "images"

_CATALOG = re.compile(r"catalog_([0-9]+)\.catalog")
_RECORD = re.compile(r"record_([0-9]+)\.json")
_PICTURE = re.compile(r"[0-9]+_cam[_-]image_array_\.jpg")  # other cameras and depths have other names
DEFAULT_RATE_HZ: Final = 20  # of DonkeyCar's loop by default
_MAX_JSON_BYTES: Final = 1 << 24  # of a file: a catalogue of DonkeyCar's thousand records has 0.3 MB


@dataclass(frozen=True)
class TubRecord:
    name: str  # its file or line, for people
    index: int
    values: dict[str, object]


@dataclass(frozen=True)
class Tub:
    version: str
    images: Path  # the folder of the pictures
    deleted: frozenset[int]
    start_ns: int | None
    time_field: str  # milliseconds
    is_time_from_start: bool  # otherwise from 1970
    records: list[TubRecord]  # in the tub's order


def is_tub(folder: Path) -> bool:
    """True if `folder` looks like a DonkeyCar tub, whole or damaged."""
    try:
        names = {path.name for path in folder.iterdir()}
    except OSError:
        return False
    return bool(names & {MANIFEST, META}) or any(_RECORD.fullmatch(n) or _CATALOG.fullmatch(n) for n in names)


def read_tub(folder: Path, skipped: Skipped, car: Car | None = None) -> RawRecording:
    """The records of the tub in `folder`. Raises RecordingError if it is not a tub or cannot be read.

    DonkeyCar's angle is our steering. Its throttle is -1..1. Speed is unknown.
    """
    tub = open_tub(folder, skipped)
    with readable(folder):
        pictures = PictureFolder([tub.images])
    rows = [_row(tub, record) for record in tub.records]
    is_from_start = tub.is_time_from_start or all(row.time is None for row in rows)
    metadata = recording_metadata("donkeycar", folder, car) | {"tub_version": tub.version, "clock": "recorded"}
    if tub.start_ns is None and is_from_start:
        metadata |= FROM_1970
    return RawRecording(
        folder,
        metadata,
        rows,
        noun="records",
        time_unit="ms",
        start_ns=tub.start_ns if is_from_start else None,
        rate_hz=DEFAULT_RATE_HZ,
        folder=pictures,
        is_picture=lambda name: _PICTURE.fullmatch(name) is not None,
        without_rows=f"{folder}: no usable record in this DonkeyCar tub",
    )


def _row(tub: Tub, record: TubRecord) -> RecordedRow:
    values = record.values
    row = RecordedRow(record.name, position=record.index)
    picture = values.get("cam/image_array")
    if isinstance(picture, str):
        name = re.split(r"[/\\]", picture)[-1]
        row.pictures = {"center": name} if name not in ("", ".", "..") else {}
    row.time = finite(values.get(tub.time_field))
    angle, throttle = finite(values.get("user/angle")), finite(values.get("user/throttle"))
    row.steering = math.nan if angle is None else angle
    row.throttle = math.nan if throttle is None else throttle
    if record.index in tub.deleted:
        row.problem = "deleted records"
    elif values.get("user/mode") not in ("user", None):
        row.problem = "records driven by DonkeyCar's pilot"
    elif throttle is None:
        row.problem = "records whose throttle is not a finite number"
    return row


def open_tub(folder: Path, skipped: Skipped) -> Tub:
    """The tub in `folder`. Raises RecordingError if it is not a tub or cannot be read."""
    if not folder.is_dir():
        raise RecordingError(f"{folder}: no such folder; give a DonkeyCar tub, such as ~/mycar/data")
    root = Path(os.path.realpath(folder))
    files = _files(root, root, skipped)
    if MANIFEST in files:
        return _open_version_2(root, files, skipped)
    if META in files or any(map(_RECORD.fullmatch, files)):
        return _open_version_1(root, files, skipped)
    if any(map(_CATALOG.fullmatch, files)):
        return _open_version_2(root, files, skipped)
    raise RecordingError(f"{folder}: not a DonkeyCar tub: neither {MANIFEST} nor {META} is in it")


def _open_version_1(root: Path, files: dict[str, Path], skipped: Skipped) -> Tub:
    start_ns = _start_ns(_load(files[META]), "start") if META in files else None
    deleted = _indexes(_load(files[EXCLUDED])) if EXCLUDED in files else frozenset[int]()
    if deleted is None:
        skipped.add("lists of deleted records that cannot be read", EXCLUDED)
    matches = [match for match in map(_RECORD.fullmatch, files) if match]
    numbered = sorted((int(match[1]), match[0]) for match in matches)
    records = []
    for index, name in numbered:
        values = _load(files[name])
        if isinstance(values, dict):
            records.append(TubRecord(name, index, values))
        else:
            skipped.add("records that cannot be read as a JSON object", name)
    return Tub("1", root, deleted or frozenset(), start_ns, "milliseconds", True, records)


def _open_version_2(root: Path, files: dict[str, Path], skipped: Skipped) -> Tub:
    lines = [_parse(line) for _, line in _lines(files[MANIFEST])] if MANIFEST in files else []
    created, last = (lines[at] if len(lines) > at else None for at in (3, 4))
    numbers = {name: int(match[1]) for name in files if (match := _CATALOG.fullmatch(name))}
    catalogs = sorted(numbers, key=lambda name: (numbers[name], name))
    paths = last.get("paths") if isinstance(last, dict) else None
    deleted = _indexes(last.get("deleted_indexes")) if isinstance(last, dict) else None
    if deleted is None or not isinstance(paths, list):
        # DonkeyCar rewrites this line with every record: if the car loses its power, the line is incomplete.
        skipped.add("lists of deleted records that cannot be read", MANIFEST)
    else:
        # As in DonkeyCar, only listed catalogues are read.
        listed = list(dict.fromkeys(re.split(r"[/\\]", path)[-1] for path in paths if isinstance(path, str)))
        for name in listed:
            if name not in files:
                skipped.add("catalogues that are not there", ascii(name))
        for name in catalogs:
            if name not in listed:
                skipped.add(f"catalogues that the manifest does not name (without {MANIFEST}, all are read)", name)
        catalogs = [name for name in listed if name in files]
    records, position = [], 0
    for name in catalogs:
        for line_number, line in _lines(files[name]):
            values = _parse(line)
            if isinstance(values, dict):
                number = values.get("_index")
                index = number if isinstance(number, int) and not isinstance(number, bool) else position
                records.append(TubRecord(f"{name} line {line_number}", index, values))
            else:
                skipped.add("records that cannot be read as a JSON object", f"{name} line {line_number}")
            position += 1
    images = root / IMAGES
    if images.is_symlink() and not images.is_dir():
        raise RecordingError(f"{images}: a link to {images.readlink()}, which is not there")
    start_ns = _start_ns(created, "created_at")
    return Tub("2", images, deleted or frozenset(), start_ns, "_timestamp_ms", False, records)


def finite(value: object) -> int | float | None:
    """A finite JSON number that fits a float; None for other values, also for true and false."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    try:
        return value if math.isfinite(value) else None
    except OverflowError:  # a whole number of over 308 digits
        return None


def _start_ns(values: object, field: str) -> int | None:
    """The time in seconds under `field`; None if it is missing or no log can hold it."""
    start_s = finite(values.get(field)) if isinstance(values, dict) else None
    if start_s is None or not 0 <= start_s < LAST_TIME_NS // 10**9:
        return None
    return round(start_s * 1e6) * 1000  # a float holds today's date to microseconds


def _indexes(values: object) -> frozenset[int] | None:
    return frozenset(value for value in values if isinstance(value, int)) if isinstance(values, list) else None


def _files(place: Path, root: Path, skipped: Skipped) -> dict[str, Path]:
    """The files in `place` by name. Links count only if their target is in `root`, a path without links."""
    files: dict[str, Path] = {}
    with readable(place), os.scandir(place) as entries:
        for entry in entries:
            if entry.name == IMAGES:
                continue
            if entry.is_symlink() and not Path(os.path.realpath(entry.path)).is_relative_to(root):
                skipped.add("links out of the tub", entry.name)
            elif Path(entry.path).is_file():
                files[entry.name] = Path(entry.path)
    return files


def _lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """The non-empty lines, numbered from 1. DonkeyCar ends lines with CR LF, on Windows with CR CR LF."""
    with readable(path):
        lines = read_bounded(path, _MAX_JSON_BYTES).split(b"\n")
    yield from ((number, line) for number, line in enumerate(lines, start=1) if line.strip())


def _load(path: Path) -> object:
    try:
        return _parse(read_bounded(path, _MAX_JSON_BYTES))
    except OSError:
        return None


def _parse(text: bytes) -> object:
    """The value of a JSON text; None for other text, or for JSON that is too deep or long for Python."""
    try:
        parsed: object = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return parsed
