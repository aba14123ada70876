"""What a reader of a recording returns: plain rows that nobody has judged, and what it says of
itself."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from common.car import Camera
from recorder.log.meant_gaps import MeantGap
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
