"""The odd stretches of a log, by its rows and its pictures; and the stretches of a filter."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common.car import CAMERAS
from common.errors import printable
from common.stretches import stretches
from dataset.frames.distinct_rows import paired_rows
from dataset.frames.frame_flags import ImageFindings, Paired, frame_flags
from recorder import Log
from recorder.log.findings import findings
from recorder.log.tags import EXCLUDE, FINE, Tag, TaggedRows
from recorder.rows.causes import CAUSES, NOT_LEARNT, PICTURE_FLAGS, PLAIN
from recorder.rows.condition import lists_with
from recorder.rows.odd_stretches import odd_stretches
from recorder.rows.row_quality import States
from recorder.topics import camera_topic
from web.logs.open_logs import OpenLog
from web.logs.picture_checks import PictureChecks

SURE: Final = "sure"
"""Takes the place of a kind: all rows that are surely odd."""

Rows = tuple[int, int]


class ShownStretch(NamedTuple):
    """Odd rows of a log, by their positions among its rows."""

    kind: str
    first: int
    last: int
    cause: str
    is_sure: bool


def shown_stretches(log: Log, states: States, images: ImageFindings | None) -> list[ShownStretch]:
    """The odd stretches of a log, in order. With the check of the log's pictures, they include frozen and broken
    pictures, and steering that contradicts the pictures.

    A gap is a stretch of two rows: the last row before it and the first row after it. Gaps that the recorder made
    on purpose are left out.
    """
    result = []
    for odd in odd_stretches(states):
        first, last = (int(np.flatnonzero(states.row == row)[0]) for row in (odd.first_row, odd.last_row))
        result.append(ShownStretch(odd.kind, first, last, printable(odd.cause), odd.is_sure))
    meant = found.meant_gaps if (found := findings(log)) else []
    gaps = states.flags["gap"] & ~np.isin(states.row, meant)
    result += [ShownStretch("gap", max(at - 1, 0), at, "", False) for at in np.flatnonzero(gaps).tolist()]
    result += [
        ShownStretch(flag, first, last, "", CAUSES[flag].is_sure)
        for flag, mask in _of_pictures(log, states, images).items()
        for first, last in stretches(mask)
    ]
    return sorted(result, key=lambda stretch: (stretch.first, stretch.last, stretch.kind))


def flag_stretches(states: States) -> dict[str, list[tuple[int, int]]]:
    """The first and last positions of the stretches of each of `PLAIN`."""
    if not len(states.row):
        return {}
    flags = states.flags
    return {flag: stretches(flags[flag]) for flag in PLAIN if flags[flag].any()}


def not_learnt_stretches(states: States) -> list[tuple[int, int]]:
    """The first and last positions of the stretches that training leaves out by default."""
    if not len(states.row):
        return []
    return stretches(np.logical_or.reduce([states.flags[flag] for flag in NOT_LEARNT]))


def _of_pictures(log: Log, states: States, images: ImageFindings | None) -> dict[str, NDArray[np.bool_]]:
    """A mask (N,) of rows for each flag of pictures."""
    paired = {camera: Paired(*paired_rows(log.pictures(camera_topic(camera)), states)) for camera in CAMERAS}
    flags = pa.chunked_array([frame_flags(states, paired, images)])
    row = states.row[np.concatenate([frames.state for frames in paired.values()])]
    return {flag: np.isin(states.row, row[lists_with(flags, flag)]) for flag in PICTURE_FLAGS}


def stretches_of_kind(opened: OpenLog, checks: PictureChecks, kind: str) -> list[Rows]:
    """First and last row of each stretch of a kind or flag, or of all stretches that are surely odd."""
    states = opened.states
    if not len(states.row):
        return []
    if kind in PLAIN:
        return [_rows(states, first, last) for first, last in flag_stretches(states).get(kind, ())]
    return [
        _rows(states, stretch.first, stretch.last)
        for stretch in shown_stretches(opened.log, states, checks.findings(opened.log))
        if (stretch.is_sure if kind == SURE else stretch.kind == kind)
    ]


def stretches_of_rows(opened: OpenLog, rows: set[int]) -> list[Rows]:
    """First and last row of each stretch of rows."""
    states = opened.states
    return [_rows(states, first, last) for first, last in stretches(np.isin(states.row, list(rows)))]


def not_dealt_with(stretches: list[Rows], tags: list[Tag]) -> list[Rows]:
    """The stretches with a row that is neither excluded nor fine."""
    done = TaggedRows(tag._replace(name=FINE) for tag in tags if tag.name in (EXCLUDE, FINE))
    return [rows for rows in stretches if not done.cover(*rows)]


def _rows(states: States, first: int, last: int) -> Rows:
    low, high = sorted((int(states.row[first]), int(states.row[last])))
    return low, high
