"""The tables that bc-index prints: the sessions, and the steering's distribution before and after balancing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.markup import escape
from rich.table import Table

from common.command import DONE, warn
from common.errors import counted, first_of, printable
from common.location import Location
from common.output import print_message, prints_unicode
from dataset.index.build import Indexed
from dataset.index.sessions import unfinished_recordings
from dataset.samples.samples_format import COUNT_HEADINGS, Balance, SessionLabels, not_learnt_line
from recorder.rows.label_plan import wrong_timing
from recorder.rows.steering_habits import STEERING_HEADINGS, steering_cells

BAR_CELLS = 13  # a line of the table then fits 80 columns
MAX_BINS = 101  # with more bins, no line for each bin is printed
_RARE = ("not_taken_over", "unlabelled", "not_driven")  # counts with a column only if there are any


def sessions_table(indexed: Indexed) -> Table:
    rare = [name for name in _RARE if any(getattr(counts, name) for counts in indexed.counts.values())]
    headings = COUNT_HEADINGS | {"not_driven": "not driven"}
    columns = ["frames", "training", "validation", "gap", "left out", *(headings[name] for name in rare)]
    # a narrow table, so that the names of sessions fit 80 columns
    table = Table(
        box=None, pad_edge=False, collapse_padding=True, title="frames, one for each picture", title_justify="left"
    )
    table.add_column("session")
    for heading in columns:
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("log", no_wrap=True)
    for session in indexed.sessions:
        counts = indexed.counts[session]
        left_out = counts.excluded + counts.unusable + counts.not_asked_for
        numbers = [counts.frames, counts.training, counts.validation, counts.gap, left_out]
        numbers += [getattr(counts, name) for name in rare]
        state = "read" if session in indexed.read else "unchanged"
        table.add_row(escape(session), *(f"{number:,}" for number in numbers), state)
    return table


def labels_table(labels: Mapping[str, SessionLabels]) -> Table:
    table = Table(box=None, pad_edge=False, title="steering", title_justify="left")
    for heading in ("session", *STEERING_HEADINGS, "labels"):
        table.add_column(heading, no_wrap=heading in STEERING_HEADINGS)
    for session, session_labels in labels.items():
        cells = steering_cells(session_labels.habits, session_labels.lag)
        table.add_row(escape(session), *cells, str(session_labels.plan))
    return table


def balance_table(balance: Balance) -> Table:
    """The samples of the training split in each steering bin. If left and right are equal, only one side is
    shown."""
    bins = len(balance.before)
    target = f"; each bin brought to {balance.per_bin:,}" if balance.per_bin else "; not balanced"
    is_mirrored = all((counts == counts[::-1]).all() for counts in (balance.before, balance.after))
    sides = ", to each side" if is_mirrored else ""
    table = Table("|steering|" if is_mirrored else "steering", title=f"training samples{sides}{target}")
    for heading in ("before", "", "after", "", "note"):
        table.add_column(heading)
    if bins > MAX_BINS:
        return table
    widest = max(1, int(balance.before.max()), int(balance.after.max()))
    for i in range(bins // 2 if is_mirrored else 0, bins):
        before, after = int(balance.before[i]), int(balance.after[i])
        low, high = -1 + 2 * i / bins, -1 + 2 * (i + 1) / bins
        note = f"{balance.short[i]:,} short" if i in balance.short else "" if before else "empty"
        table.add_row(
            f"{max(low, 0):.2f} .. {high:.2f}" if is_mirrored else f"{low:+.2f} .. {high:+.2f}",
            f"{before:,}",
            _bar(before, widest),
            f"{after:,}",
            _bar(after, widest),
            note,
        )
    return table


def print_log_notices(indexed: Indexed, folder: Location, sessions: Sequence[str] = ()) -> int:
    """Print the notices about an index's logs, and about unfinished recordings in `folder` (with `sessions`, only
    of these). Returns exit code 3 if there are any, else 0."""
    code = max([DONE, *map(warn, [*indexed.notices, *unfinished_recordings(folder, sessions)])])
    not_learnt = not_learnt_line(indexed.counts)
    steering = [*_wrong_steering(indexed.labels), *_shared_rows(indexed.labels)]
    for remark in [*indexed.remarks, *steering, *mixed_sizes(indexed.sizes_px), *not_learnt]:
        print_message(remark)
    return code


def _wrong_steering(labels: Mapping[str, SessionLabels]) -> list[str]:
    """A line for each session whose pictures turn the other way, or whose steering is late or early by more than
    labels correct."""
    lines = []
    for name, session_labels in labels.items():
        lag = session_labels.lag
        if lag is not None and lag.is_mirrored:
            lines.append(f"{printable(name)}: its pictures turn the other way: is left right?")
        elif lag is not None and (timing := wrong_timing(lag)):
            lines.append(f"{printable(name)}: its steering is {timing}")
    return lines


def _shared_rows(labels: Mapping[str, SessionLabels]) -> list[str]:
    shared = {printable(name): session_labels.shared_rows for name, session_labels in labels.items()}
    parts = [f"{name} ({counted(len(rows), 'row')} from row {rows[0]})" for name, rows in shared.items() if rows]
    if not parts:
        return []
    return [
        f"the same pictures of a standing car in several sessions: {first_of(parts)}; none of them is held out"
    ]


def mixed_sizes(sizes_px: Mapping[str, Sequence[tuple[int, int]]]) -> list[str]:
    sessions: dict[tuple[int, int], list[str]] = {}
    for session, sizes in sizes_px.items():
        for size in sizes:
            sessions.setdefault(size, []).append(session)
    if len(sessions) < 2:
        return []
    parts = []
    for (width, height), names in sorted(sessions.items(), reverse=True):
        parts.append(f"{width:,} x {height:,} px in {first_of(list(map(printable, names)))}")
    return [
        f"pictures of different sizes: {'; '.join(parts)}. The toolkit cuts the same share off all of them, and"
        " resizes the rest to the network's input: they should show the same part of the world"
    ]


def _bar(count: int, widest: int) -> str:
    """A bar in steps of an eighth of a cell; a count above 0 has at least one step. An encoding without blocks, as
    Windows gives to a file of `bc-index > FILE`, gets "#" for each begun cell."""
    eighths = max(round(BAR_CELLS * 8 * count / widest), int(count > 0))
    if not prints_unicode():
        return "#" * -(-eighths // 8)
    return "█" * (eighths // 8) + ("", "▏", "▎", "▍", "▌", "▋", "▊", "▉")[eighths % 8]
