"""The flags that name rows of a log: --rows, or --start and --end in seconds."""

from __future__ import annotations

import math

from common.errors import UsageError
from common.location import Location


def rows_of_flags(
    path: Location, start_s: float | None, end_s: float | None, rows: tuple[int, int] | None
) -> tuple[int, int]:
    """The rows that the flags name."""
    from recorder.log.reader import Log  # NumPy
    from recorder.upkeep.edit import check_rows, rows_between

    if rows is not None:
        if start_s is not None or end_s is not None:
            raise UsageError("give either --rows, or --start and --end")
        if not 0 <= rows[0] <= rows[1]:
            raise UsageError(f"--rows {rows[0]} {rows[1]}: give the first row, then the last one")
        with Log(path) as log:
            check_rows(log, rows)
        return rows
    with Log(path) as log:
        return rows_between(log, *times_of_flags(start_s, end_s))


def times_of_flags(start_s: float | None, end_s: float | None) -> tuple[float, float]:
    begin_s, finish_s = 0.0 if start_s is None else start_s, math.inf if end_s is None else end_s
    if not begin_s <= finish_s:
        raise UsageError(f"--start {begin_s:g} --end {finish_s:g}: give seconds, the start before the end")
    return begin_s, finish_s
