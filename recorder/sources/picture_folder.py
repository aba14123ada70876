"""Finds the pictures that a recording names, whatever system and language named them."""

from __future__ import annotations

import os
import re
import time
import unicodedata
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from common import Skipped
from recorder.errors import RecordingError

LINKS: Final = "pictures that are links out of the recording"
MISSING: Final = "pictures that a row names and no file has, or several have"
WITHOUT_ROW: Final = "pictures without a row"
MAX_FILES: Final = 5_000_000
ENDINGS: Final = (".jpg", ".jpeg", ".png")
_TICK_NS: Final = 1_000_000_000
_NUMBER: Final = re.compile(r"[0-9]{1,18}")


class PictureFolder:
    """Finds a picture by its path in the folder, its name, its name without ending, or its number.

    Case and accents' encoding do not matter. With several places, the first that has the name counts; in a folder
    with inner folders, a name or number of several pictures finds nothing. A link is followed only within the
    places: a recording is untrusted. A place itself may be a link: users may keep the pictures elsewhere.
    """

    def __init__(self, places: Sequence[Path], *, is_deep: bool = False) -> None:
        """Lists the pictures. Raises RecordingError for a folder that cannot be read."""
        self.places = places
        self.links = set[str]()  # out of the places
        self._is_deep = is_deep
        self._read: dict[str, int] | None = None
        self.refresh()

    def refresh(self) -> None:
        """List the pictures again, if a place has changed, or did within the last second: a file that comes in the
        same tick of the clock does not show."""
        changed = {str(place): place.stat().st_mtime_ns for place in self.places if place.is_dir()}
        last_ns = max(changed.values(), default=0)
        if changed == self._read and time.time_ns() - last_ns > _TICK_NS:
            return
        self._read = changed
        self.paths: dict[str, str] = {}  # by path in its place, with slashes
        self._by_name: dict[str, str | None] = {}  # None: several
        self._by_number: dict[int, str | None] = {}
        self._roots = [os.path.realpath(place) for place in self.places]
        for place in self.places:
            for within, path in self._pictures(place):
                if within in self.paths:
                    continue
                self.paths[within] = path
                if len(self.paths) > MAX_FILES:
                    raise RecordingError(f"{place}: over {MAX_FILES:,} pictures; give a folder of one recording")
                name = folded(within.rpartition("/")[2])
                stem = name.rpartition(".")[0]
                for key in {name, stem}:
                    self._by_name[key] = None if key in self._by_name else path
                if digits := _NUMBER.findall(stem):
                    number = int(digits[-1])
                    self._by_number[number] = None if number in self._by_number else path

    def find(self, named: str) -> str | None:
        """The path of the picture with this name in a recording; None if no picture, or several, match."""
        slashed = named.replace("\\", "/").removeprefix("./")
        if (path := self.paths.get(slashed)) is not None:
            return path
        name = slashed.rpartition("/")[2]
        if not self._is_deep and (path := self.paths.get(name)) is not None:
            return path
        key = folded(name)
        if key in self._by_name:
            return self._by_name[key]
        whole = name.removesuffix(".0")  # some programs write whole numbers as floats
        return self._by_number.get(int(whole)) if self._is_deep and _NUMBER.fullmatch(whole) else None

    def skip_missing(self, named: str, skipped: Skipped) -> None:
        """Skip a picture that is not found: a link out of the recording is called so."""
        last = re.split(r"[/\\]", named)[-1]
        skipped.add(LINKS if last in self.links else MISSING, named[-200:])

    def without_row(self, named: set[str]) -> list[str]:
        """The pictures whose paths are not `named`, sorted: the order of a folder depends on the disk."""
        return sorted(within for within, path in self.paths.items() if path not in named)

    def why_none(self) -> str:
        """The probable reason if no picture was found."""
        for place in self.places:
            if place.is_symlink() and not place.exists():
                return f"{place} is a link to {place.readlink()}, which is not there"
        if self.links:
            return "its pictures are links out of it, which are not followed; `cp -rL` copies what they name"
        if self._is_deep:
            return f"no .jpg, .jpeg or .png in {self.places[0]}, nor in the folders in it"
        return "they are expected in " + ", ".join(f"{place}/" for place in self.places)

    def _pictures(self, place: Path, within: str = "") -> Iterator[tuple[str, str]]:
        try:
            with os.scandir(place / within) as entries:
                listed = sorted(entries, key=lambda entry: entry.name)
        except (FileNotFoundError, NotADirectoryError):
            return
        except OSError as error:
            raise RecordingError(f"{error.filename}: cannot be read ({error.strerror})") from None
        for entry in listed:
            if not entry.name.lower().endswith(ENDINGS):
                continue
            if entry.is_symlink() and not self._is_inside(entry.path):
                self.links.add(entry.name)
            elif os.path.isfile(entry.path) if entry.is_symlink() else entry.is_file():  # noqa: PTH113
                yield within + entry.name, entry.path
        for entry in listed if self._is_deep else ():
            if entry.is_dir(follow_symlinks=False):
                yield from self._pictures(place, f"{within}{entry.name}/")

    def _is_inside(self, path: str) -> bool:
        real = Path(os.path.realpath(path))
        return any(real.is_relative_to(root) for root in self._roots)


def folded(name: str) -> str:
    """A name as all systems compare it: macOS splits accents from letters, Windows ignores case."""
    return name if name.isascii() and name.islower() else unicodedata.normalize("NFC", name).casefold()
