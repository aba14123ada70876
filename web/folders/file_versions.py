"""Versions of files and folders: short texts that change when a command writes there. No file is read."""

from __future__ import annotations

import hashlib
import os
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final, Generic, TypeVar

from common.files import PART_SUFFIX
from common.location import Location
from dataset.index.build_state import Stat

_GROWING_STEP: Final = 22  # bits: 4 MB, because an unfinished log is read in full for each version

Place = TypeVar("Place", bound=Location)
Value = TypeVar("Value")


class Newest(Generic[Place, Value]):
    """Values made from files: one for each of the files used last, of the file's newest version."""

    def __init__(self, max_kept: int) -> None:
        self._max_kept = max_kept
        self._lock = threading.Lock()
        self._values: dict[Place, tuple[str, Value]] = {}

    def get(self, place: Place, version: str, make: Callable[[], Value]) -> Value:
        """The kept value of this version, or what `make` returns."""
        with self._lock:
            kept = self._values.get(place)
        value = kept[1] if kept is not None and kept[0] == version else make()
        with self._lock:
            self._values.pop(place, None)
            self._values[place] = version, value
            while len(self._values) > self._max_kept:
                self._values.pop(next(iter(self._values)))
        return value


def version_of(*paths: Path) -> str:
    """The version of files: it changes when one of them is written, replaced or removed."""
    digest = hashlib.sha256()
    for path in paths:
        try:
            status = path.stat()
        except OSError:
            digest.update(b"none;")
        else:
            digest.update(f"{status.st_dev},{status.st_ino},{status.st_size},{status.st_mtime_ns};".encode())
    return digest.hexdigest()[:16]


def version_of_growing(path: Path) -> str:
    """The version of a file that is being written: it changes with every 4 MB."""
    try:
        status = path.stat()
    except OSError:
        return "none"
    return f"{status.st_ino:x}.{status.st_size >> _GROWING_STEP:x}"


def version_of_stats(stats: Iterable[tuple[Location, Stat]]) -> str:
    """The version of objects in a store, by their sizes and ETags."""
    digest = hashlib.sha256()
    for place, stat in stats:
        digest.update(f"{place},{stat};".encode())
    return digest.hexdigest()[:16]


def version_of_folder(folder: Path) -> str:
    """The version of a folder: its names, sizes and times, without subfolders; "" without a folder."""
    digest = hashlib.sha256()
    try:
        with os.scandir(folder) as entries:
            for line in sorted(_lines(entries)):
                digest.update(line)
    except OSError:
        return ""
    return digest.hexdigest()[:16]


def _lines(entries: Iterable[os.DirEntry[str]]) -> Iterable[bytes]:
    for entry in entries:
        name = os.fsencode(entry.name)
        try:
            status = entry.stat()
        except OSError:  # deleted meanwhile, or a broken link
            yield name
            continue
        if entry.name.endswith(PART_SUFFIX):
            yield b"%s,%d" % (name, status.st_size >> _GROWING_STEP)
        else:
            yield b"%s,%d,%d" % (name, status.st_size, status.st_mtime_ns)
