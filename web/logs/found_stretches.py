"""The stretches of a log that a filter of the list of sessions finds: those of a kind, or with rows for which a
condition holds."""

from __future__ import annotations

from typing import Final

import numpy as np

from common.stretches import stretches
from recorder.log.tags import EXCLUDE, FINE, Tag
from recorder.rows.row_quality import States
from web.logs.open_logs import OpenLog
from web.logs.picture_checks import PictureChecks
from web.logs.session_stretches import PLAIN_FLAGS, flag_stretches, shown_stretches

SURE: Final = "sure"
Rows = tuple[int, int]


def stretches_of_kind(opened: OpenLog, checks: PictureChecks, kind: str) -> list[Rows]:
    """First and last row of each stretch of a kind or flag, or of all that are surely odd."""
    states = opened.states
    if not len(states.row):
        return []
    if kind in PLAIN_FLAGS:
        return [_rows(states, first, last) for first, last in flag_stretches(states).get(kind, ())]
    found = shown_stretches(opened.log, states, checks.findings(opened.log))
    return [
        _rows(states, each.first, each.last)
        for each in found
        if (each.is_sure if kind == SURE else each.kind == kind)
    ]


def stretches_of_rows(opened: OpenLog, rows: set[int]) -> list[Rows]:
    """First and last row of each stretch of rows."""
    states = opened.states
    return [_rows(states, first, last) for first, last in stretches(np.isin(states.row, list(rows)))]


def left(found: list[Rows], tags: list[Tag]) -> list[Rows]:
    """Those with a row that is neither excluded nor fine."""
    done = [(tag.first_row, tag.last_row) for tag in tags if tag.name in (EXCLUDE, FINE)]  # in order
    return [rows for rows in found if not _is_covered(rows, done)]


def _is_covered(rows: Rows, done: list[Rows]) -> bool:
    reached = rows[0]
    for first, last in done:
        if first > reached:
            break
        reached = max(reached, last + 1)
    return reached > rows[1]


def _rows(states: States, first: int, last: int) -> Rows:
    low, high = sorted((int(states.row[first]), int(states.row[last])))
    return low, high
