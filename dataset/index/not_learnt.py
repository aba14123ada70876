"""What the default labels leave out: crashes, driving backwards, manoeuvres, parked cars. A network neither learns
from them nor is measured by them."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from common.errors import counted, first_of, printable
from dataset.parquet_file import read_metadata
from dataset.samples.samples_format import SAMPLES_NAME, SessionCounts


def not_learnt_line(counts: Mapping[str, SessionCounts]) -> list[str]:
    """A line if frames are left out because they are no driving: how many of each session, and why."""
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
    return [
        f"neither learnt nor held out: {first_of(parts)}; `bc-log info` lists their rows,"
        " `--labels as-recorded` keeps them"
    ]


def not_learnt_in(index: Path) -> list[str]:
    """The same of an index, as far as it says so; of an earlier version's, that its rules were others."""
    stored = read_metadata(index / SAMPLES_NAME) or {}
    if has_earlier_rules(stored):
        flag = "" if index.name == "index" else f" --index {shlex.quote(str(index))}"
        return [
            f"{index}: an earlier version made it, which held out crashes and did not know all that is odd;"
            f" `bc-index{flag}` leaves these out"
        ]
    try:
        return not_learnt_line(msgspec.convert(stored["counts"], dict[str, SessionCounts]))
    except (KeyError, TypeError, ValueError):
        return []


def has_earlier_rules(metadata: Mapping[str, Any]) -> bool:
    """Whether an earlier version made an index of these samples' metadata, and left out less of what a person
    drove, or nothing of it for measuring."""
    try:
        kept = {name for name, each in metadata.get("labels", {}).items() if not each["plan"]["without_crashes"]}
        return any("not_measured" not in count for name, count in metadata["counts"].items() if name not in kept)
    except (KeyError, TypeError, AttributeError):
        return False
