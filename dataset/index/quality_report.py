"""The report on unusual frames of an index: the stretches of each flag, by session."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from rich.markup import escape
from rich.table import Table

from common.errors import counted
from common.output import print_table
from common.stretches import stretches
from dataset.errors import DatasetError
from dataset.frames.distinct_rows import number_distinct
from dataset.index.build_state import FRAMES_FOLDER
from recorder.rows.row_quality import NOT_LEARNT, ROW_FLAGS

_COLUMNS = ("session", "row", "log_time_ns", "flags")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True)
class FlaggedFrames:
    """Neighbouring rows of a session with a flag on some frame. A gap begins at the row before it."""

    session: str
    flag: str
    first_row: int
    last_row: int
    begin_s: float  # from the session's first row
    end_s: float
    begin_utc: str  # ISO 8601, to the millisecond
    frames: int  # that have the flag: of up to three cameras in each row
    rows: int


def find_flagged_frames(index: Path | str) -> list[FlaggedFrames]:
    """The flagged stretches of `index`, by session and row; reads its frames files alone.

    Raises DatasetError if there is no index, or if it is damaged.
    """
    folder = Path(index) / FRAMES_FOLDER
    files = sorted(folder.glob("*.parquet"))
    if not files:
        raise DatasetError(f"{folder}: no index; build it with `bc-index`")
    found = [reported for file in files for reported in _stretches_of(file)]
    return sorted(found, key=lambda reported: (reported.session, reported.first_row, reported.flag))


def print_quality_report(reported: Sequence[FlaggedFrames]) -> None:
    """Print the stretches as a table, then how many rows each flag has. What of a car that nobody drives lies
    together, as a crash and the way out of it, is one line."""
    if not reported:
        print_table("no frame has a flag")
        return
    table = Table(box=None, pad_edge=False)
    for name in ("session", "flag", "rows", "seconds", "begins (UTC)"):
        table.add_column(name, no_wrap=name in ("flag", "rows", "seconds"))
    flagged: dict[str, int] = {}
    for one in reported:
        flagged[one.flag] = flagged.get(one.flag, 0) + one.rows
    for one in _joined(reported):
        # as `bc-log tag` and `bc-play` take them: rows and seconds that are typed have no thousands separators
        rows = f"{one.first_row}" if one.first_row == one.last_row else f"{one.first_row} to {one.last_row}"
        seconds = f"{one.begin_s:.2f} to {one.end_s:.2f}"
        table.add_row(escape(one.session), escape(one.flag), rows, seconds, one.begin_utc[:19].replace("T", " "))
    print_table(table)
    print_table(", ".join(f"{counted(count, 'row')} {escape(flag)}" for flag, count in sorted(flagged.items())))


def _joined(reported: Sequence[FlaggedFrames]) -> list[FlaggedFrames]:
    """The stretches, with those of `NOT_LEARNT` that overlap or touch as one, and without what its rows have of
    other flags."""
    whole = list[FlaggedFrames]()
    for one in reported:
        if one.flag not in NOT_LEARNT:
            continue
        last = whole[-1] if whole else None
        if last is None or last.session != one.session or one.first_row > last.last_row + 1:
            whole.append(one)
        else:
            flag = last.flag if one.flag in last.flag.split(", ") else f"{last.flag}, {one.flag}"
            end_row, end_s = max((last.last_row, last.end_s), (one.last_row, one.end_s))
            whole[-1] = replace(last, flag=flag, last_row=end_row, end_s=end_s)
    begins = [(each.session, each.first_row) for each in whole]

    def is_held(one: FlaggedFrames) -> bool:
        at = bisect_right(begins, (one.session, one.first_row)) - 1
        return at >= 0 and whole[at].session == one.session and one.last_row <= whole[at].last_row

    others = [
        one for one in reported if one.flag not in NOT_LEARNT and not (one.flag in ROW_FLAGS and is_held(one))
    ]
    return sorted([*whole, *others], key=lambda one: (one.session, one.first_row, one.flag))


def _stretches_of(file: Path) -> Iterator[FlaggedFrames]:
    damaged = DatasetError(f"{file}: damaged, or not of an index; remove it and give `bc-index`")
    if file.is_symlink():
        raise damaged
    try:
        table = pq.read_table(file, columns=list(_COLUMNS), page_checksum_verification=True).combine_chunks()
        session = table["session"].cast(pa.string())
        row, time_ns = (table[name].cast(pa.int64()).to_numpy() for name in ("row", "log_time_ns"))
        flags = table["flags"].combine_chunks()
        frame = pc.list_parent_indices(flags).to_numpy()
        names = pc.list_flatten(flags).cast(pa.string())
    except (OSError, ValueError, KeyError, pa.ArrowException):
        raise damaged from None
    if any(table[name].null_count for name in _COLUMNS) or names.null_count:
        raise damaged
    if not len(row):
        return
    # Frames of several cameras share a row; and a log that is still growing may hold late pictures behind others.
    number, frame_of = number_distinct(time_ns, row)
    row, time_ns = row[frame_of], time_ns[frame_of]
    for flag in pc.unique(names).to_pylist():
        of_flag = frame[pc.equal(names, flag).to_numpy(zero_copy_only=False)]
        frames = np.bincount(number[of_flag], minlength=len(row))
        for first, last in stretches(frames > 0):
            begin_ns = int(time_ns[max(first - 1, 0) if flag == "gap" else first])
            yield FlaggedFrames(
                session[0].as_py(),
                flag,
                int(row[first]),
                int(row[last]),
                (begin_ns - int(time_ns[0])) / 1e9,
                (int(time_ns[last]) - int(time_ns[0])) / 1e9,
                (_EPOCH + timedelta(microseconds=begin_ns // 1000)).isoformat(timespec="milliseconds"),
                int(frames[first : last + 1].sum()),
                int(last + 1 - first),
            )
