"""The files that an index or a run may refer to. Files in other places are not opened.

Allowed are files

- in the project: the folder that contains the index; for an index in a store, its bucket
- in a folder that the user has named (`--sessions FOLDER`, else sessions/ and drives/): see `allow_places`
- in the folders from which this user has built the index or trained the run: see `remember_places`
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Final

import msgspec

from common.errors import UserError
from common.files import atomic_file
from common.location import Location, Url, absolute, is_in_store, location
from common.untrusted import read_bounded, real_path
from common.untrusted_json import json_as
from common.users_cache import users_cache

FOLDER: Final = "built-here"
_MAX_RECORD_BYTES: Final = 1 << 22
MAX_RECORDS: Final = 1_000
"""With more, the records of indexes and runs that do not exist any more are removed."""
_BY_DEFAULT: Final = (Path("sessions"), Path("drives"))

_named: list[Location] = []
"""The folders that the user has named in this process."""
_remembered: dict[str, list[str]] = {}
"""A copy of the cache's records that this process has made: the cache may be read-only."""


class _Record(msgspec.Struct, frozen=True):
    holder: str  # the index or the run
    folders: list[str]


class AllowedPlaces:
    """The places that `holder`, an index or a run of these projects, may refer to."""

    def __init__(self, holder: Location, *projects: Location) -> None:
        self._projects = [*map(absolute, projects)]
        self._folders = [absolute(place) for place in (*_BY_DEFAULT, *_named, *map(location, _recorded(holder)))]
        self._folder_outside = cache(self._path_outside)

    def __contains__(self, place: Location) -> bool:
        return self.outside(place) is None

    def outside(self, place: Location) -> Location | None:
        """None if the place may be opened; else the forbidden place: `place`, or the target of a link. The disk is
        not read if the text of the path alone leads out of the allowed places."""
        if isinstance(place, Url):
            return None if self._is_below(place) else place
        if "\0" in str(place):
            return place
        if place.name != ".." and self._folder_outside(place.parent) is None and not place.is_symlink():
            return None
        return self._path_outside(place)

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
    """Allow the files in these folders, which the user has named, for the rest of this process."""
    _named.extend(folder for folder in map(absolute, folders) if folder not in _named)


def remember_places(holder: Location, project: Location, folders: Iterable[Location]) -> None:
    """Record the source folders of an index or a run that this user has just made, to allow them later. Folders in
    the project are always allowed, and not recorded. Nothing is recorded if the cache is read-only."""
    project = absolute(project)
    outside = sorted({str(folder) for folder in map(absolute, folders) if not _is_in_project(folder, project)})
    if not outside:
        return
    record = _Record(str(absolute(holder)), sorted({*outside, *_recorded(holder)}))
    _remembered[record.holder] = record.folders
    path = _record_path(record.holder)
    if _record_in(path) == record:
        return
    with contextlib.suppress(OSError, UserError):
        with atomic_file(path, overwrite=True) as part:
            part.write_bytes(msgspec.json.encode(record))
        _forget_removed(path.parent)


def _forget_removed(folder: Path) -> None:
    paths = list(folder.glob("*.json"))
    for path in paths if len(paths) > MAX_RECORDS else ():
        record = _record_in(path)
        if record is None or not (is_in_store(record.holder) or Path(record.holder).exists()):
            path.unlink(missing_ok=True)


def folders_of(files: Iterable[Location]) -> set[Location]:
    """The folders of these files, after following links."""
    return {absolute(file).parent for file in files}


def _is_in_project(place: Location, project: Location) -> bool:
    """True if the project contains the place. The root of the disk and the home folder are no projects: they
    contain all files of a user."""
    if isinstance(project, Url):
        return _is_within(place, Url(project.scheme, project.bucket))
    return project not in (Path(project.anchor), _home()) and _is_within(place, project)


def _is_within(place: Location, folder: Location) -> bool:
    if isinstance(place, Url):
        return isinstance(folder, Url) and (place == folder or place.is_in(folder))
    return isinstance(folder, Path) and place.is_relative_to(folder)


def _home() -> Path:
    return real_path(Path(os.path.expanduser("~")))  # noqa: PTH111 - Path.home raises without a home


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
