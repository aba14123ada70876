"""`bc-index`: logs become frames and balanced samples."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import pyarrow.compute as pc
import tyro
from rich.console import Console
from rich.table import Table

from common.command import DONE, run_command, warn
from dataset.config import IndexConfig
from dataset.index import Indexed, build_index, find_logs, unfinished_recordings


@dataclass(frozen=True)
class Index:
    """Build the index: frames and balanced samples, as parquet, from the logs.

    Only sessions that changed are read again; no picture is decoded.
    """

    sessions: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[SESSION ...]")] = ()
    """Sessions by name, or logs by path; all of the folder by default. The index then holds just these."""
    folder: Annotated[Path, tyro.conf.arg(name="sessions")] = Path("sessions")
    """Where logs are kept."""
    index: Path = Path("index")
    """Where the index is written."""
    config: tyro.conf.OmitArgPrefixes[IndexConfig] = field(default_factory=IndexConfig)


def index(config: Index) -> int:
    indexed = build_index(find_logs(config.sessions, config.folder), config.index, config.config)
    code = DONE
    for notice in [*indexed.notices, *unfinished_recordings(config.folder, indexed.sessions)]:
        code = warn(notice)
    console = Console(highlight=False)
    console.print(_sessions(indexed))
    console.print(_balance(indexed))
    splits = indexed.samples["split"].value_counts().to_pylist()
    counts = ", ".join(f"{row['counts']:,} {row['values']}" for row in splits)
    print(f"{indexed.path}: {len(indexed.frames):,} frames, {len(indexed.samples):,} samples ({counts})")
    return code


def _sessions(indexed: Indexed) -> Table:
    table = Table("session", "frames", "training", "validation", "out of range", "")
    for session in indexed.sessions:
        frames = indexed.frames.filter(pc.equal(indexed.frames["session"], session))
        split = frames["split"].to_pylist()
        bad = sum(1 for flags in frames["flags"].to_pylist() if "out_of_range" in flags)
        state = "read" if session in indexed.read else "unchanged"
        table.add_row(
            session,
            *(f"{n:,}" for n in (len(frames), split.count("train"), split.count("validation"), bad)),
            state,
        )
    return table


def _balance(indexed: Indexed) -> Table:
    """The training split's steering, bin by bin, before and after balancing."""
    balance = indexed.balance
    widest = max(1, int(balance.before.max()))
    table = Table(
        "steering", "before", "", "after", "short", title=f"training samples; mean of the bins {balance.per_bin:,}"
    )
    bins = len(balance.before)
    for i in range(bins):
        low, high = -1 + 2 * i / bins, -1 + 2 * (i + 1) / bins
        bar = "█" * round(30 * int(balance.before[i]) / widest)
        short = f"{balance.short[i]:,}" if i in balance.short else ""
        table.add_row(f"{low:+.2f} .. {high:+.2f}", f"{balance.before[i]:,}", bar, f"{balance.after[i]:,}", short)
    return table


def main() -> None:
    run_command("bc-index", Index, index)
