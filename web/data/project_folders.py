"""The folders that the workbench shows. Names in addresses are looked up in listings, never joined to a path."""

from __future__ import annotations

import hashlib
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, get_args

from recorder.log.log_info import logs_in
from web.errors import WebError

Place = Literal["sessions", "drives"]
"""A folder of logs, as addresses name it."""
PLACES: Final[tuple[Place, ...]] = get_args(Place)

RUN_CONFIG: Final = "config.json"  # what makes a folder a run: `model.runs.run_folder.CONFIG`, without PyTorch

_PLAIN: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")


@dataclass(frozen=True)
class ProjectFolders:
    """Where the commands keep what they write; none of them need be there yet."""

    sessions: Path = Path("sessions")
    index: Path = Path("index")
    runs: Path = Path("runs")
    drives: Path = Path("drives")
    _found: dict[tuple[Place, str], Path] = field(default_factory=dict, init=False, repr=False)  # by a listing

    @property
    def are_new(self) -> bool:
        """True while none of them is there."""
        return not any(folder.exists() for folder in (self.sessions, self.index, self.runs, self.drives))

    @property
    def parent(self) -> Path | None:
        """The folder that all of them are in by their usual names; None if they are elsewhere."""
        parent = self.sessions.parent
        usual = (parent / name for name in ("sessions", "index", "runs", "drives"))
        return parent if (self.sessions, self.index, self.runs, self.drives) == tuple(usual) else None

    def logs(self, place: Place) -> dict[str, Path]:
        """The logs of a folder by the key that they have in addresses; {} where there is no such folder."""
        return {key_of(path): path for path in logs_in(getattr(self, place))}

    def log(self, place: Place, key: str) -> Path:
        """Raises WebError if no log of that key is there (any more)."""
        path = self._found.get((place, key))
        if path is not None and path.is_file():  # a folder of a thousand logs is not listed for each picture
            return path
        path = self.logs(place).get(key)
        if path is None:
            folder = getattr(self, place)
            raise WebError(f"{folder}: no log {key!r} in it; it may have been deleted, renamed or moved", 404)
        self._found[place, key] = path
        return path

    def run_folders(self) -> dict[str, Path]:
        """The runs by the key that they have in addresses, also those that cannot be read."""
        return {key_of(path.parent): path.parent for path in sorted(self.runs.glob(f"*/{RUN_CONFIG}"))}

    def run(self, key: str) -> Path:
        """Raises WebError if no run of that key is there (any more)."""
        path = self.run_folders().get(key)
        if path is None:
            raise WebError(f"{self.runs}: no run {key!r} in it; it may have been deleted, renamed or moved", 404)
        return path


def key_of(path: Path) -> str:
    """What a file or folder is called in addresses: its name (without .mcap) where that is plain, else a hash of
    it: a name may hold whatever a file system takes, even bytes that are no text."""
    name = path.name.removesuffix(".mcap")
    if _PLAIN.fullmatch(name):
        return name
    return "~" + hashlib.sha256(os.fsencode(path.name)).hexdigest()[:20]
