"""The places that an index, or a run, may name: a file elsewhere is not opened because they name it.

Allowed is what lies

- in the project: the folder in which the index lies; of one in a store, its bucket
- in a folder that the user has named (`--sessions FOLDER`, else sessions/ and drives/), which `allow_places` adds
- where this user has built the index from, or what he trained the run on, as `remember_places` keeps it
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable
from hashlib import sha256
from pathlib import Path
from typing import Final

import msgspec

from common.errors import UserError
from common.files import atomic_file
from common.location import Location, Url, absolute, location
from common.untrusted import read_bounded, real_path
from common.untrusted_json import json_as
from common.users_cache import users_cache

FOLDER: Final = "built-here"
_MAX_RECORD_BYTES: Final = 1 << 22
_BY_DEFAULT: Final = (Path("sessions"), Path("drives"))

_named: list[Location] = []
"""The folders that were named in this process."""
_remembered: dict[str, list[str]] = {}
"""The same as in the cache, of what was built in this process: the cache may be one that cannot be written to."""


class _Record(msgspec.Struct, frozen=True):
    """What an index, or a run, was made of."""

    holder: str  # the index or the run
    folders: list[str]


class AllowedPlaces:
    """The places that the files of `holder`, an index or a run of these projects, may lead to."""

    def __init__(self, holder: Location, *projects: Location) -> None:
        self._projects = [*map(absolute, projects)]
        self._folders = [absolute(place) for place in (*_BY_DEFAULT, *_named, *map(location, _recorded(holder)))]
        self._holds: dict[Path, bool] = {}

    def __contains__(self, place: Location) -> bool:
        return self.outside(place) is None

    def outside(self, place: Location) -> Location | None:
        """None for a place that may be opened; else itself, or that to which a link there leads. The disk is not
        asked about a path whose text alone leads out."""
        if isinstance(place, Url):
            return None if self._is_below(place) else place
        if "\0" in str(place):
            return place
        if place.name != ".." and self._holds_folder(place.parent) and not place.is_symlink():
            return None
        return self._path_outside(place)

    def _holds_folder(self, folder: Path) -> bool:
        if folder not in self._holds:
            self._holds[folder] = self._path_outside(folder) is None
        return self._holds[folder]

    def _path_outside(self, path: Path) -> Path | None:
        by_text = Path(os.path.abspath(path))  # noqa: PTH100 - it follows no link
        if not self._is_below(by_text):
            return by_text
        real = real_path(path)
        return None if self._is_below(real) else real

    def _is_below(self, place: Location) -> bool:
        is_in_project = any(_is_in_project(place, project) for project in self._projects)
        return is_in_project or any(_is_within(place, folder) for folder in self._folders)


def allow_places(*folders: Location) -> None:
    """Allow what lies in these folders from now on in this process: its user has named them."""
    _named.extend(folder for folder in map(absolute, folders) if folder not in _named)


def remember_places(holder: Location, project: Location, folders: Iterable[Location]) -> None:
    """Allow what lies in these folders to an index, or a run, that this user has just made of it on this machine;
    what its project holds need not be kept. A cache that cannot be written to keeps nothing."""
    project = absolute(project)
    outside = sorted({str(folder) for folder in map(absolute, folders) if not _is_in_project(folder, project)})
    if not outside:
        return
    record = _Record(str(absolute(holder)), sorted({*outside, *_recorded(holder)}))
    _remembered[record.holder] = record.folders
    path = _record_path(record.holder)
    if _record_in(path) == record:
        return
    with contextlib.suppress(OSError, UserError), atomic_file(path, overwrite=True) as part:
        part.write_bytes(msgspec.json.encode(record))


def folders_of(files: Iterable[Location]) -> set[Location]:
    """The folders in which these files lie, whatever links lead to them."""
    return {absolute(file).parent for file in files}


def _is_in_project(place: Location, project: Location) -> bool:
    """A project is never the root of the disk, nor a home: these hold all that somebody has."""
    if isinstance(project, Url):
        return _is_within(place, Url(project.scheme, project.bucket))
    return project not in (Path(project.anchor), _home()) and _is_within(place, project)


def _is_within(place: Location, folder: Location) -> bool:
    if isinstance(place, Url):
        return isinstance(folder, Url) and (place == folder or place.is_in(folder))
    return isinstance(folder, Path) and place.is_relative_to(folder)


def _home() -> Path:
    return real_path(Path(os.path.expanduser("~")))  # noqa: PTH111 - Path.home raises where there is none


def _recorded(holder: Location) -> list[str]:
    name = str(absolute(holder))
    if name in _remembered:
        return _remembered[name]
    record = _record_in(_record_path(name))
    return record.folders if record is not None and record.holder == name else []


def _record_path(holder: str) -> Path:
    return users_cache() / FOLDER / f"{sha256(os.fsencode(holder)).hexdigest()[:32]}.json"


def _record_in(path: Path) -> _Record | None:
    try:
        return json_as(read_bounded(path, _MAX_RECORD_BYTES), _Record)
    except OSError:
        return None
