"""Finding the recording near a path that is none: a folder above it, a folder in it, or one of its files."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Final

from recorder.sources.donkeycar_tub import is_tub
from recorder.sources.lerobot_dataset import is_lerobot
from recorder.sources.ros2_bag import is_bag
from recorder.sources.udacity_recording import CSV_NAME

_MOST_FOLDERS: Final = 200  # that are searched: somebody's home may hold anything
_MOST_SUGGESTED: Final = 3


def is_udacity(folder: Path) -> bool:
    return os.path.isfile(folder / CSV_NAME)  # noqa: PTH113  (never raises)


def recordings_near(source: Path) -> str:
    """ " did you mean ...?", naming the recordings near `source`; "" without any."""
    found = list(islice(_search(source), _MOST_SUGGESTED + 1))
    if not found:
        return ""
    more = " or another one there" if len(found) > _MOST_SUGGESTED else ""
    return f" did you mean {' or '.join(map(str, found[:_MOST_SUGGESTED]))}{more}?"


def _search(source: Path) -> Iterator[Path]:
    """The recording that `source` is a part of; else those in it, and in the folders in it."""
    for folder in list(source.absolute().parents)[:2]:
        if _is_recording(folder) and source.exists():
            yield _as_given(folder, source)
            return
    folders = [source]
    for _ in range(2):
        folders = list(islice((inner for folder in folders for inner in _folders_in(folder)), _MOST_FOLDERS))
        yield from filter(_is_recording, folders)


def _is_recording(folder: Path) -> bool:
    return is_udacity(folder) or is_tub(folder) or is_bag(folder) or is_lerobot(folder)


def _folders_in(folder: Path) -> list[Path]:
    try:
        with os.scandir(folder) as entries:
            some = islice(entries, 100 * _MOST_FOLDERS)
            return sorted(path for entry in some if (path := folder / entry.name).is_dir())
    except OSError:
        return []


def _as_given(folder: Path, source: Path) -> Path:
    """An absolute folder above `source`, written as `source` is."""
    return folder if source.is_absolute() else Path(os.path.relpath(folder))
