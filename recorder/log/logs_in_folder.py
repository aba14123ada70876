"""The logs of a folder, on this machine or in a store."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import overload

from common.location import Location, Url


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
