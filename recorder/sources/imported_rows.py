"""The rows of recordings: as a reader returns them, with nobody's judgement, and as they are written to a log."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from common import Skipped
from common.car import Camera
from common.errors import MAX_KEPT_NAMES
from recorder.bc_pb2 import VehicleState
from recorder.errors import RecordingError
from recorder.log.meant_gaps import MeantGap
from recorder.log.session_car import Car, metadata_of
from recorder.log.writer import LogWriter
from recorder.sources.picture_folder import PictureFolder
from recorder.sources.settings import TimeUnit

Picture: TypeAlias = str | Callable[[], bytes]
"""The name of a picture's file, or a function that reads the picture and may raise UnreadablePictureError."""


class UnreadablePictureError(Exception):
    """A picture, or a message, cannot be read; the text is the reason."""


@dataclass(slots=True)
class RecordedRow:
    name: str
    """For people: "line 12", "/camera at 3.250 s"."""
    time: float | None = None
    """In the recording's unit; None without one."""
    steering: float | None = None
    """In the recording's scale; None if `Recording.commands` has it."""
    throttle: float = 0.0
    """-1..1: below 0, it brakes."""
    brake: float = 0.0
    speed: float = math.nan
    """In the recording's unit."""
    pictures: Mapping[Camera, Picture] = field(default_factory=dict)
    problem: str = ""
    """Why the row cannot be used; "" otherwise."""
    position: int | None = None
    """Rows before it, when that is not its place in the list."""
    episode: int | None = None
    """Times of an episode begin anew."""
    camera: Camera | None = None
    """Set if each camera has rows of its own."""
    gap: MeantGap | None = None
    """Before the row."""


@dataclass
class RawRecording:
    path: Path
    metadata: dict[str, str]
    """For the log; `source` is the format."""
    rows: Sequence[RecordedRow]
    noun: str = "rows"
    time_unit: TimeUnit = "s"
    start_ns: int | None = None
    """The moment from which times count; None: from 1970, or unknown."""
    rate_hz: float | None = None
    """Rows a second, if the format has a usual rate and the rows have no times."""
    mph: float = 1.0
    """The factor from its unit of speed to mph."""
    commands: tuple[NDArray[np.int64], NDArray[np.float64]] | None = None
    """Times in the recording's unit, ascending, and the steering that each began; None if rows have it."""
    folder: PictureFolder | None = None
    """Where the named pictures are."""
    is_picture: Callable[[str], bool] = lambda name: True
    """Whether a picture in the folder, which no row names, belongs to the recording."""
    is_by_arrival: bool = False
    """Times are those of a clock that never goes back: rows out of order were only written late."""
    keeps_rows_without_pictures: bool = False
    without_rows: str = "no row of it can be used"
    hint: str = ""
    """What to do if no row can be used."""
    camera_column: str = ""
    """A column that seems to name the camera of each row, which nobody has chosen."""
    warnings: Sequence[str] = ()
    """For the log and for people."""
    notices: Sequence[str] = ()
    """For people."""
    opened: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)
    """Files from which pictures are read; the import closes them."""
    missing: Callable[[], Iterable[tuple[str, str]]] = tuple
    """What the recording promises and does not have, found at the end: reason and name."""


AFTER_QUESTIONS: Final = (
    "It is imported as it is. If the answer is yes, import it again with the flag and --force."
)
VIDEOS_ENCODED_ANEW: Final = "decoded from videos and encoded anew: these are not the camera's original pictures"
FROM_1970: Final = {"start": "1970, because the recording does not have it"}
"""Metadata of a log whose recording has no date."""


@dataclass(frozen=True)
class Imported:
    path: Path
    rows: int
    pictures: int
    skipped: Skipped
    notices: Sequence[str] = ()  # lines about its content
    questions: Sequence[str] = ()  # what only the user can know, with the flags that answer it
    others: Sequence[Imported] = ()  # of further simulators at the same time


class SkippedEvents:
    """Counts what an import skips, and writes an event about each to its log.

    Events before the log is open wait for it. After a thousand events of a kind, the rest is only counted.
    """

    def __init__(self) -> None:
        self.skipped = Skipped(self._added)
        self.time_ns = 0
        """The time of the following events: that of their row."""
        self._writer: LogWriter | None = None

    def write_to(self, writer: LogWriter, time_ns: int) -> None:
        """Write events to this log from now on; the earlier ones, now, at its first time."""
        self._writer, self.time_ns = writer, time_ns
        for reason, name in self.skipped:
            self._added(reason, name)
        for reason, count in self.skipped.counts.items():
            if count > MAX_KEPT_NAMES:
                self._added(reason, f"and {count - MAX_KEPT_NAMES:,} more")

    def _added(self, reason: str, name: str) -> None:
        if self._writer is not None:
            self._writer.event(self.time_ns, f"skipped {reason}: {name}", "WARNING", "recorder")


@dataclass(frozen=True)
class ImportedRow:
    time_ns: int
    state: VehicleState
    pictures: Iterable[tuple[Camera, bytes]]  # JPEG or PNG, byte for byte
    gap: MeantGap | None = None  # before the row


def recording_metadata(source: str, recording: Path, car: Car | None) -> dict[str, str]:
    """The metadata about the origin of an imported log."""
    return {"source": source, "recording": Path(os.path.realpath(recording)).name} | metadata_of(car)


def write_log(
    log: Path,
    metadata: dict[str, str],
    rows: Iterator[ImportedRow],
    events: SkippedEvents,
    without_rows: str,
    *,
    warnings: Sequence[str] = (),
    overwrite: bool,
) -> Imported:
    """Write rows, numbered from 0, with events about skipped ones. `warnings` become events at the first row.

    Raises RecordingError if there is no row (its text begins with `without_rows`), or no picture: then no log is
    created.
    """
    first = next(rows, None)
    if first is None:
        raise RecordingError(f"{without_rows}{events.skipped.error_suffix()}")
    count = pictures = 0
    with LogWriter(log, metadata, overwrite=overwrite) as writer:
        for text in warnings:
            writer.event(first.time_ns, text, "WARNING", "recorder")
        events.write_to(writer, first.time_ns)
        for row in itertools.chain([first], rows):
            for camera, picture in row.pictures:
                writer.picture(camera, row.time_ns, count, picture)
                pictures += 1
            writer.vehicle(row.time_ns, count, row.state, row.gap)
            count += 1
        if not pictures:  # inside, so that the log is discarded
            raise RecordingError(
                f"{metadata['recording']}: no picture of it can be used{events.skipped.error_suffix()}"
            )
    return Imported(log, count, pictures, events.skipped, [*warnings, *writer.notices])
