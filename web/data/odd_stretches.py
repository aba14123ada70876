"""The stretches of a log that something is odd in: the flags of its rows, and those known of its pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from common.car import CAMERAS
from common.errors import printable
from common.stretches import stretches
from dataset.config import IndexConfig
from dataset.frames.frame_flags import ImageFindings, PictureFlag, lists_with
from dataset.frames.frames_file import session_name
from dataset.frames.frames_table import frames_of
from recorder import Log
from recorder.log.meant_gaps import meant_rows
from recorder.log.row_quality import States, row_flags
from recorder.log.topics import QUALITY_METADATA, camera_topic


@dataclass(frozen=True)
class OddStretch:
    """A flag, and the first and last of its rows as positions among the log's rows."""

    flag: str
    first: int
    last: int


def odd_stretches(log: Log, states: States, findings: ImageFindings | None) -> list[OddStretch]:
    """The odd stretches of a log, in order. Frozen and broken pictures, and steering that contradicts them, are
    among them where `findings` of the log's pictures are given.

    A gap is a stretch of two rows: the last before it and the first after it. One that the recorder meant is none.
    """
    masks: dict[str, NDArray[np.bool_]] = dict(row_flags(states).items())
    masks["gap"] &= ~np.isin(states.row, meant_rows(log.read_metadata(QUALITY_METADATA)))
    pictures = {camera: log.pictures(camera_topic(camera)) for camera in CAMERAS}
    session = printable(session_name(log.path))  # a file name may be no text
    frames = frames_of(states, pictures, session, IndexConfig(), findings=findings)
    for flag in get_args(PictureFlag):
        rows = frames["row"].to_numpy()[lists_with(frames["flags"], flag)]
        masks[flag] = np.isin(states.row, rows)
    found = [
        OddStretch(flag, first - (flag == "gap" and first > 0), last)
        for flag, mask in masks.items()
        for first, last in stretches(mask)
    ]
    return sorted(found, key=lambda stretch: (stretch.first, stretch.last, stretch.flag))
