"""`index/state.json`: what the files were from which an index was made, so that unchanged ones need not be opened.

Sizes and times of modification; it may be deleted at any time: then every log is read again.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from common import atomic_file
from dataset.index.image_check_cache import LOOKS_FOLDER
from recorder.log.tags import tags_path

FRAMES_FOLDER: Final = "frames"
STATE_NAME: Final = "state.json"

Stat = list[int] | None
"""Size and time of modification (ns) of a file; None where there is none."""


@dataclass(frozen=True)
class Entry:
    """What is remembered of a log."""

    sources: list[Any]  # what its frames are made of, before it was read: what changes from then on is noticed
    fingerprint: str = ""  # empty if it was left out
    frames: Stat = None  # of its frames file
    notice: str = ""  # what to tell a person
    has_crcs: bool = True
    sizes_px: list[list[int]] = field(default_factory=list)  # width and height of the first picture of each camera

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> Entry:
        """Raises TypeError or ValueError if it is none."""
        entry = cls(**stored)
        texts = (entry.fingerprint, entry.notice)
        sides = [side for width, height in entry.sizes_px for side in (width, height)]
        if not all(isinstance(text, str) for text in texts) or not all(isinstance(side, int) for side in sides):
            raise ValueError("not what is remembered of a log")
        if not isinstance(entry.has_crcs, bool):
            raise ValueError("not what is remembered of a log")
        return entry


@dataclass(frozen=True)
class State:
    samples: Stat = None
    logs: dict[str, Entry] = field(default_factory=dict)
    passed_over: list[str] = field(default_factory=list)  # logs that were not to be indexed, by somebody's choice


def sources_of(session: str, log: Path, index: Path) -> list[Any]:
    """What a session's frames are made of: the log, its tags, and what was seen in its pictures."""
    return [os.path.realpath(log), *map(stat_of, (log, tags_path(log), index / LOOKS_FOLDER / f"{session}.json"))]


def stat_of(path: Path) -> Stat:
    try:
        status = path.stat()
    except OSError:
        return None
    return [status.st_size, status.st_mtime_ns]


def read_state(index: Path) -> State:
    """What is remembered; nothing if that is missing, damaged, or of an older version."""
    try:
        stored = json.loads((index / STATE_NAME).read_bytes())
        logs = {str(name): Entry.from_dict(entry) for name, entry in stored["logs"].items()}
        return State(stored["samples"], logs, [str(name) for name in stored["passed_over"]])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return State()


def write_state(path: Path, samples: Stat, logs: Mapping[str, Entry], passed_over: Sequence[str]) -> None:
    stored = {
        "samples": samples,
        "logs": {name: vars(entry) for name, entry in logs.items()},
        "passed_over": sorted(passed_over),
    }
    with atomic_file(path, overwrite=True) as part:
        part.write_text(json.dumps(stored, indent=1, sort_keys=True) + "\n", encoding="utf-8")
