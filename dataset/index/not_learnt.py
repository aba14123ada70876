"""What the default labels leave out of training: crashes, driving backwards, manoeuvres, parked cars."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import msgspec

from common.errors import counted, printable
from dataset.parquet_file import read_metadata
from dataset.samples.samples_format import SAMPLES_NAME, SessionCounts

_MAX_NAMES: Final = 8


def not_learnt_line(counts: Mapping[str, SessionCounts]) -> list[str]:
    """A line if frames are left out of training as no driving: how many of which session, and why."""
    parts = []
    for session, of_session in counts.items():
        reasons = {
            "of crashes": of_session.crashed,
            "of driving backwards": of_session.backwards,
            "of manoeuvres about them": of_session.manoeuvring,
            "of a parked car": of_session.parked,
        }
        if of_session.not_driven:
            named = ", ".join(f"{counted(count, 'frame')} {reason}" for reason, count in reasons.items() if count)
            parts.append(f"{printable(session)} ({named})")
    if not parts:
        return []
    more = f" and {len(parts) - _MAX_NAMES:,} more" if len(parts) > _MAX_NAMES else ""
    return [
        f"not learnt: {', '.join(parts[:_MAX_NAMES])}{more}; `bc-index --report` lists their rows,"
        " `--labels as-recorded` learns them"
    ]


def not_learnt_in(index: Path) -> list[str]:
    """The same of an index, as far as it says so."""
    try:
        counts = msgspec.convert((read_metadata(index / SAMPLES_NAME) or {})["counts"], dict[str, SessionCounts])
    except (KeyError, TypeError, ValueError):
        return []
    return not_learnt_line(counts)
