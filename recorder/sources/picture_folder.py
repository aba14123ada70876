"""The pictures in a folder and the folders in it, found by whatever name a csv has for them."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from recorder.errors import RecordingError

MAX_FILES: Final = 5_000_000
ENDINGS: Final = (".jpg", ".jpeg", ".png")
_NUMBER: Final = re.compile(r"[0-9]{1,18}")


class PictureFolder:
    """Finds a picture by its path in the folder, by its name, by its name without ending, or by its number.

    A name that several folders have, or a number that several pictures have, is none. Links are not followed.
    """

    def __init__(self, root: Path) -> None:
        """Raises RecordingError for a folder that cannot be read, or without a picture."""
        self.root = root
        self.paths: dict[str, str] = {}  # by the path within the root, with slashes
        self._by_name: dict[str, str | None] = {}  # None: several
        self._by_number: dict[int, str | None] = {}
        for within, path in _pictures(root):
            self.paths[within] = path
            if len(self.paths) > MAX_FILES:
                raise RecordingError(f"{root}: over {MAX_FILES:,} pictures; give a folder of one recording")
            name = within.rpartition("/")[2]
            stem = name.rpartition(".")[0]
            for called in {name, stem}:
                self._by_name[called] = None if called in self._by_name else path
            if digits := _NUMBER.findall(stem):
                number = int(digits[-1])
                self._by_number[number] = None if number in self._by_number else path
        if not self.paths:
            raise RecordingError(f"{root}: no .jpg, .jpeg or .png in it, nor in the folders in it")

    def find(self, named: str) -> str | None:
        """The path of the picture that a csv calls so; None without one, or if several may be meant."""
        slashed = named.replace("\\", "/").removeprefix("./")
        if slashed in self.paths:
            return self.paths[slashed]
        name = slashed.rpartition("/")[2]
        if name in self._by_name:
            return self._by_name[name]
        whole = name.removesuffix(".0")  # a table that made floats of numbers
        return self._by_number.get(int(whole)) if _NUMBER.fullmatch(whole) else None


def _pictures(root: Path) -> Iterator[tuple[str, str]]:
    """Path within the root, and path, of every picture; in the order of their names."""

    def refuse(error: OSError) -> None:
        raise RecordingError(f"{error.filename}: cannot be read ({error.strerror})") from None

    for folder, folders, names in os.walk(root, onerror=refuse):
        folders.sort()
        within = os.path.relpath(folder, root).replace(os.sep, "/")
        prefix = "" if within == "." else f"{within}/"
        for name in sorted(names):
            path = os.path.join(folder, name)  # noqa: PTH118  (a Path of each would take longer)
            if name.lower().endswith(ENDINGS) and not os.path.islink(path):  # noqa: PTH114
                yield prefix + name, path
