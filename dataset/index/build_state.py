"""`index/state.json`: what the files were from which an index was made, so that unchanged ones need not be opened.

Sizes and times of modification; it may be deleted at any time: then every log is read again.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Final

import msgspec

from common import atomic_file
from common.car import MAX_STEERING_DEG
from dataset.frames.image_check_cache import image_check_path
from recorder.log.tags import tags_path

FRAMES_FOLDER: Final = "frames"
STATE_NAME: Final = "state.json"

Stat = tuple[int, int] | None
"""Size and time of modification (ns) of a file; None where there is none."""
Sources = tuple[str, Stat, Stat, Stat]


class BuiltLog(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A log as it was when the index was built."""

    sources: Sources  # what its frames are made of, before it was read: what changes from then on is noticed
    fingerprint: str = ""  # of its content; empty if it was left out
    file: str = ""  # the fingerprint of the file, in which pictures have their places
    frames: Stat = None  # of its frames file
    notice: str = ""  # what to tell a person
    has_crcs: bool = True
    driven_by: str = ""  # the machine that drove it
    set_speeds_mph: tuple[float, ...] | None = None  # of its driver; None in what earlier versions have written
    sizes_px: list[tuple[int, int]] = []  # width and height of the first picture of each camera
    max_steering_deg: float = MAX_STEERING_DEG  # of its wheels, at steering 1
    car: str = ""  # as the log tells it, in JSON


class BuildState(msgspec.Struct, frozen=True):
    samples: Stat
    logs: dict[str, BuiltLog]
    passed_over: list[str]  # logs that were not to be indexed, by somebody's choice

    @classmethod
    def nothing(cls) -> BuildState:
        """That of an index which is built anew."""
        return cls(None, {}, [])


def sources_of(session: str, log: Path, index: Path) -> Sources:
    """The files that a session's frames are made of: the log, its tags, and the check of its pictures."""
    findings = stat_of(image_check_path(index, session))
    return os.path.realpath(log), stat_of(log), stat_of(tags_path(log)), findings


def stat_of(path: Path) -> Stat:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns


def read_state(index: Path) -> BuildState:
    """The state of the last build; an empty one if it is missing, damaged, or of an older version."""
    try:
        stored = json.loads((index / STATE_NAME).read_bytes())  # msgspec.json reads no names that are not UTF-8
        return msgspec.convert(stored, BuildState)
    except (OSError, ValueError, RecursionError):
        return BuildState.nothing()


def write_state(path: Path, state: BuildState) -> None:
    with atomic_file(path, overwrite=True) as part:
        stored = json.dumps(msgspec.to_builtins(state), indent=1, sort_keys=True)
        part.write_text(stored + "\n", encoding="utf-8")
