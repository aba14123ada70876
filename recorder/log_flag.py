"""Finds logs: by path, URL, or the name of a session or drive; those of a folder; the flags that name them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final, TypeAlias, overload

from common.errors import UserError
from common.location import Location, Url, local_path, location
from common.location_flag import location_spec

SESSIONS: Final = Path("sessions")
FOLDERS: Final = (SESSIONS, Path("drives"))  # where logs are looked for by name


def named_log(place: Location, *, takes_folders: bool = False) -> Location:
    """The log of the session or drive named `place`, if there is one; `place` itself for other logs and files. A
    folder of this name comes first only with `takes_folders`.

    Raises UserError if a session and a drive have this name.
    """
    if isinstance(place, Url) or len(place.parts) != 1 or place.suffix in (".mcap", ".part"):
        return place
    if os.path.lexists(place) and (takes_folders or not place.is_dir()):
        return place
    logs = [log for folder in FOLDERS if (log := folder / f"{place}.mcap").is_file()]
    if len(logs) > 1:
        raise UserError(f"{place}: {' and '.join(map(str, logs))} have this name; give one of them")
    return logs[0] if logs else place


LogFlag: TypeAlias = Annotated[Path, location_spec("LOG", lambda text: local_path(named_log(location(text))))]
"""A log on this machine."""
LogOrUrlFlag: TypeAlias = Annotated[Location, location_spec("LOG", lambda text: named_log(location(text)))]
LogOrFolderFlag: TypeAlias = Annotated[
    Location, location_spec("LOG", lambda text: named_log(location(text), takes_folders=True))
]


@overload
def logs_in(folder: Path) -> list[Path]: ...


@overload
def logs_in(folder: Url) -> list[Url]: ...


def logs_in(folder: Location) -> list[Path] | list[Url]:
    """The logs of a folder by name, finished and unfinished. Raises StoreError."""
    if isinstance(folder, Url):
        from common.object_store import list_objects  # an extra

        return [entry.url for entry in list_objects(folder) if entry.url.suffix == ".mcap"]
    return sorted((*folder.glob("*.mcap"), *folder.glob("*.mcap.*.part")))


def logs_at(place: Location) -> Sequence[Location]:
    """The logs of a folder, or the log at `place`. Raises StoreError."""
    is_folder = place.suffix != ".mcap" if isinstance(place, Url) else place.is_dir()
    return logs_in(place) if is_folder else [place]
