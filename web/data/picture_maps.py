"""Maps of the pictures of logs by what they show: made by a process of its own, and kept in the cache by the
fingerprints of the logs and of the run whose network looks at them."""

from __future__ import annotations

import contextlib
import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from common.location import Location
from web.data.kept_work import KeptWork
from web.data.project_folders import as_word

COLUMNS: Final = ("x", "y", "log", "row", "steering", "predicted", "nearest", "alone", "group", "odd")
"""Of each picture, as float32: its place, the number of its log, its row, the steering that was driven and
predicted (NaN: none), how far the most alike picture and its neighbours are (1 is usual), its group, and the
number of what is odd in its row (-1: nothing)."""
_FORMAT: Final = 1


class MapAbout(msgspec.Struct, frozen=True):
    """What a map is of."""

    step: int  # of so many pictures, one is shown
    odd: list[str]  # the kinds that `odd` has numbers of
    groups: list[int]  # the picture in the middle of each group
    max_deg: float | None  # the wheels' angle at steering 1; None: unknown, or several
    notes: list[str]  # what was left out


@dataclass(frozen=True)
class MappedLog:
    """A log whose pictures are shown."""

    at: str  # its address: /sessions/KEY
    path: Location
    fingerprint: str


class PictureMaps:
    """Maps that are kept, and those that are being made."""

    def __init__(self, cache: Path) -> None:
        self.work = KeptWork(cache / "maps", "web.data.picture_map_process", "it was stopped")

    def key(self, logs: Sequence[MappedLog], run: Path | None) -> str:
        """The name that a map has here. Raises WebError for a run without weights."""
        words = [str(_FORMAT), self.work.fingerprint(run) if run else "", *(log.fingerprint for log in logs)]
        return hashlib.sha256(" ".join(words).encode()).hexdigest()

    def find(self, key: str) -> MapAbout | None:
        """What the map of that key is of; None where it was not made yet, or is kept no more."""
        path = self.work.path(key)
        try:
            with np.load(path, allow_pickle=False) as kept:
                return msgspec.json.decode(kept["about"].tobytes(), type=MapAbout)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, EOFError, msgspec.MsgspecError):  # damaged: it is made again
            with contextlib.suppress(OSError):
                path.unlink()
            return None

    def columns(self, key: str) -> bytes | None:
        """COLUMNS, one after the other."""
        try:
            with np.load(self.work.path(key), allow_pickle=False) as kept:
                data = io.BytesIO()
                for name in COLUMNS:
                    data.write(kept[name].astype("<f4").tobytes())
                return data.getvalue()
        except (OSError, ValueError, KeyError, EOFError):
            return None

    def start(self, key: str, logs: Sequence[MappedLog], run: Path | None) -> None:
        """Begin with it, if it is not under way."""
        pairs = [word for log in logs for word in (log.fingerprint, as_word(log.path))]
        self.work.start(key, 0, [str(run.absolute()) if run else "", *pairs])
