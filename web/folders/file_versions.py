"""Versions of files and folders: short texts that change when a command writes there. No file is read."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from common.files import PART_SUFFIX

_GROWING_STEP: Final = 22  # bits: 4 MB, because an unfinished log is read in full for each version


def version_of(*paths: Path) -> str:
    """The version of files: it changes when one of them is written, replaced or removed."""
    return digest(map(_state, paths))


def _state(path: Path) -> str:
    try:
        status = path.stat()
    except OSError:
        return "none"
    return f"{status.st_dev},{status.st_ino},{status.st_size},{status.st_mtime_ns}"


def version_of_growing(path: Path) -> str:
    """The version of a file that is being written: it changes with every 4 MB."""
    try:
        status = path.stat()
    except OSError:
        return "none"
    return f"{status.st_ino:x}.{status.st_size >> _GROWING_STEP:x}"


def version_of_folder(folder: Path) -> str:
    """The version of a folder: its names, sizes and times, without subfolders; "" without a folder."""
    try:
        with os.scandir(folder) as entries:
            return digest(sorted(map(_line, entries)))
    except OSError:
        return ""


def digest(lines: Iterable[str]) -> str:
    """A short text that changes with these lines."""
    return hashlib.sha256(os.fsencode("\n".join(lines))).hexdigest()[:16]


def _line(entry: os.DirEntry[str]) -> str:
    try:
        status = entry.stat()
    except OSError:  # deleted meanwhile, or a broken link
        return entry.name
    if entry.name.endswith(PART_SUFFIX):
        return f"{entry.name},{status.st_size >> _GROWING_STEP}"
    return f"{entry.name},{status.st_size},{status.st_mtime_ns}"
