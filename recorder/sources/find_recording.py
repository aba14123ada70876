"""Finds recordings: their kind, all in a folder, and those near a path without one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Final, Literal

from recorder.sources.donkeycar_tub import is_tub
from recorder.sources.ros2_bag import MCAP, SQLITE, is_bag
from recorder.sources.udacity_recording import CSV_NAME

_MAX_FOLDERS: Final = 200  # searched: a home folder may hold anything
_MAX_SUGGESTED: Final = 3

FORMAT_NAMES: Final = {
    "udacity": "recording of Udacity's simulator",
    "donkeycar": "DonkeyCar tub",
    "lerobot": "LeRobot dataset",
    "mcap": "MCAP log of another program",
    "ros2 bag": "ROS 2 bag",
    "csv": "pictures with a csv",
}
"""By the name that a log's metadata have as their source."""

Kind = Literal["log", "lerobot", "tub", "udacity", ""]


def is_udacity(folder: Path) -> bool:
    return os.path.isfile(folder / CSV_NAME)  # noqa: PTH113  (never raises)


def kind_of(source: Path) -> Kind:
    """The kind that `source` looks like; empty for anything else. A log is an MCAP file, finished or not, or a ROS
    2 bag."""
    is_folder = os.path.isdir(source)  # noqa: PTH112  (never raises)
    if is_bag(source) or (not is_folder and {MCAP, SQLITE} & set(source.suffixes)):
        return "log"
    if os.path.isfile(source / "meta" / "info.json"):  # noqa: PTH113  (never raises)
        return "lerobot"
    if is_tub(source):
        return "tub"
    return "udacity" if is_udacity(source) else ""


def recordings_near(source: Path) -> str:
    """ " did you mean ...?" with the recordings near `source`; "" without any."""
    suggestions = list(islice(_search(source), _MAX_SUGGESTED + 1))
    if not suggestions:
        return ""
    more = " or another one there" if len(suggestions) > _MAX_SUGGESTED else ""
    return f" did you mean {' or '.join(map(str, suggestions[:_MAX_SUGGESTED]))}{more}?"


def recordings_in(folder: Path, levels: int = 2) -> list[Path]:
    """The recordings in a folder: the folder itself; or folders up to `levels` below, logs and csv files."""
    if _is_recording(folder):
        return [folder]
    folders = [folder, *(inner for level in islice(_levels_below(folder), levels) for inner in level)]
    recordings = [place for place in folders if _is_recording(place)]
    others = [place for place in folders if not any(place.is_relative_to(recording) for recording in recordings)]
    return [*recordings, *(path for place in others for path in _files_in(place))]


def _search(source: Path) -> Iterator[Path]:
    """The recording that `source` is a part of, or the recordings in `source` and its folders."""
    for folder in list(source.absolute().parents)[:2]:
        if _is_recording(folder) and source.exists():
            relative = Path(os.path.relpath(folder))
            is_clear = not source.is_absolute() and relative.name not in ("", "..")  # "did you mean .?"
            yield relative if is_clear else Path(os.path.normpath(folder))
            return
    for level in _levels_below(source):
        yield from filter(_is_recording, level)


def _levels_below(folder: Path) -> Iterator[list[Path]]:
    """The folders in a folder, then the folders in those."""
    folders = [folder]
    for _ in range(2):
        folders = list(islice((inner for place in folders for inner in folders_in(place)), _MAX_FOLDERS))
        yield folders


def _files_in(folder: Path) -> list[Path]:
    """The logs of a folder; without any, its only csv."""
    try:
        files = sorted(path for path in islice(folder.iterdir(), 100 * _MAX_FOLDERS) if path.is_file())
    except OSError:
        return []
    tables = [path for path in files if path.suffix.lower() == ".csv"]
    return [path for path in files if path.suffix == ".mcap"] or (tables if len(tables) == 1 else [])


def _is_recording(folder: Path) -> bool:
    return os.path.isdir(folder) and kind_of(folder) != ""  # noqa: PTH112


def folders_in(folder: Path) -> list[Path]:
    """The folders in a folder, by name; none if it cannot be read."""
    try:
        with os.scandir(folder) as entries:
            limited = islice(entries, 100 * _MAX_FOLDERS)
            return sorted(path for entry in limited if (path := folder / entry.name).is_dir())
    except OSError:
        return []
