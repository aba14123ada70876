"""Maps on which similar pictures of logs lie near each other. A process makes them. The cache keeps them by the
fingerprints of the logs and of the run whose network compares the pictures."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec

from common.location import Location
from web.folders.project_folders import as_word
from web.processes.kept_work import KeptWork, run_fingerprint

COLUMNS: Final = ("x", "y", "log", "row", "steering", "predicted", "nearest", "alone", "group", "odd")
"""Float32 columns of the pictures. `x`, `y`: its place. `log`: the number of its log. `predicted`: NaN without
one. `nearest`, `alone`: distances to the most similar picture and to its neighbours (medians: 1). `odd`: the
number of the kind of odd row, or -1."""
MAX_POINTS: Final = 10_000
_FORMAT: Final = 1


class MapAbout(msgspec.Struct, frozen=True):
    step: int  # every `step`-th picture is shown
    odd: list[str]  # the kinds of odd rows; the column `odd` has their numbers
    groups: list[int]  # the picture in the middle of each group
    max_deg: float | None  # the wheels' angle at steering 1; None: unknown, or logs have different angles
    notes: list[str]  # logs that were left out, and why


@dataclass(frozen=True)
class MappedLog:
    """A log whose pictures are shown."""

    at: str  # its address: /sessions/KEY
    path: Location
    fingerprint: str


class PictureMaps:
    """The maps that are kept, running and waiting."""

    def __init__(self, cache: Path) -> None:
        self.work = KeptWork(cache / "maps", "web.processes.picture_map_process", "it was stopped")

    def key(self, logs: Sequence[MappedLog], run: Path | None) -> str:
        """The key of a map. Raises WebError for a run without weights."""
        network = run_fingerprint(run) if run else ""
        words = [str(_FORMAT), str(MAX_POINTS), network, *(log.fingerprint for log in logs)]
        return hashlib.sha256(" ".join(words).encode()).hexdigest()

    def find(self, key: str) -> MapAbout | None:
        """The description of the map of a key; None if it is not kept."""
        return self.work.find(key, lambda kept: msgspec.json.decode(kept["about"].tobytes(), type=MapAbout))

    def columns(self, key: str) -> bytes | None:
        """COLUMNS, one after the other; None if the map is not kept."""
        return self.work.find(key, lambda kept: b"".join(kept[name].astype("<f4").tobytes() for name in COLUMNS))

    def start(self, key: str, logs: Sequence[MappedLog], run: Path | None) -> None:
        """Start it, unless it is waiting or running."""
        pairs = [word for log in logs for word in (log.fingerprint, as_word(log.path))]
        self.work.start(key, 0, [str(MAX_POINTS), str(run.absolute()) if run else "", *pairs])
