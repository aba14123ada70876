"""The folders that the workbench shows. Names in addresses are looked up in listings, never joined to a path.

No log is read.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, get_args

from common.errors import printable
from common.files import PART_SUFFIX
from common.locks import is_being_written
from model.runs.run_files import CONFIG
from recorder.log_flag import logs_in
from web.errors import WebError, or_404
from web.folders.file_versions import version_of, version_of_folder, version_of_growing

Place = Literal["sessions", "drives"]
"""A folder of logs, as addresses name it."""
PLACES: Final[tuple[Place, ...]] = get_args(Place)

_PLAIN: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")
_LOG: Final = ".mcap"


@dataclass(frozen=True)
class ProjectFolders:
    """The folders that the commands write to. They need not exist yet."""

    sessions: Path = Path("sessions")
    index: Path = Path("index")
    runs: Path = Path("runs")
    drives: Path = Path("drives")
    _listed: dict[tuple[Place, str], Path] = field(default_factory=dict, init=False, repr=False)

    @property
    def _all(self) -> list[Path]:
        return [self.sessions, self.index, self.runs, self.drives]

    @property
    def are_new(self) -> bool:
        """True while none of them exists."""
        return not any(folder.exists() for folder in self._all)

    @property
    def parent(self) -> Path | None:
        """The folder that has all of them under their usual names; None if they are elsewhere."""
        parent = self.sessions.parent
        usual = [parent / name for name in ("sessions", "index", "runs", "drives")]
        return parent if self._all == usual else None

    def flags(self, *names: str) -> list[str]:
        """The flags that name these folders for a command; none for the usual folders."""
        return [
            f"--{name}={folder}"
            for name in names
            if (folder := getattr(self, name)) != getattr(ProjectFolders, name)
        ]

    @property
    def recordings(self) -> Path:
        """The folder of recordings that browsers have uploaded."""
        return self.sessions.parent / "recordings"

    def logs(self, place: Place) -> dict[str, Path]:
        """The logs of a folder by their keys in addresses; {} without a folder."""
        return {key_of(path): path for path in logs_in(self._folder(place))}

    def _folder(self, place: Place) -> Path:
        return self.sessions if place == "sessions" else self.drives

    def finished(self, place: Place) -> dict[str, str]:
        """The names of a folder's finished logs for people, by their keys."""
        return {key: shown_name(log) for key, log in self.logs(place).items() if log.suffix == _LOG}

    def log(self, place: Place, key: str) -> Path:
        """The log of a key. Raises WebError if it does not exist (any more)."""
        listed = self._listed.get((place, key))
        if listed is not None and listed.is_file():  # a thousand logs are not listed for each picture
            return listed
        log = self.logs(place).get(key)
        if log is None:
            folder = self._folder(place)
            raise WebError(f"{folder}: no log {key!r} in it; it may have been deleted, renamed or moved", 404)
        self._listed[place, key] = log
        return log

    def version_of_folder(self, place: Place) -> str:
        return version_of_folder(self._folder(place))

    def run_folders(self) -> dict[str, Path]:
        """The folders of the runs, also unreadable ones, by their keys in addresses."""
        return {key_of(path.parent): path.parent for path in sorted(self.runs.glob(f"*/{CONFIG}"))}

    def run(self, key: str) -> Path:
        path = self.run_folders().get(key)
        return or_404(path, f"{self.runs}: no run {key!r} in it; it may have been deleted, renamed or moved")


def version_of_log(log: Path) -> str:
    """The version of a log for lists. While the log is recorded, it changes less often."""
    return version_of_growing(log) if log.name.endswith(PART_SUFFIX) else version_of(log)


def shown_name(log: Path) -> str:
    return printable(log.name.removesuffix(_LOG))


def is_recording(log: Path) -> bool:
    return log.name.endswith(PART_SUFFIX) and is_being_written(log)


def key_of(path: Path) -> str:
    """The key of a file or folder in addresses: its name without .mcap if that is plain, else its hash. Names may
    be invalid text."""
    name = path.name.removesuffix(_LOG)
    if _PLAIN.fullmatch(name):
        return name
    return "~" + hashlib.sha256(path.name.encode(errors="surrogatepass")).hexdigest()[:20]
