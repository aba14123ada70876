"""The frames that the default labels leave out: crashes, driving backwards, manoeuvres, parked cars. They are used
neither for training nor for validation."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import msgspec

from common.errors import counted, first_of, printable
from dataset.parquet_file import read_metadata
from dataset.samples.samples_format import SAMPLES_NAME, SessionCounts

EARLIER_RULES: Final = "built by an earlier version, which held out crashes and did not detect all odd frames"


def not_learnt_line(counts: Mapping[str, SessionCounts]) -> list[str]:
    """A line if frames are left out because they are not normal driving: the number in each session, and why."""
    parts = []
    for session, session_counts in counts.items():
        reasons = {
            "of crashes": session_counts.crashed,
            "of driving backwards": session_counts.backwards,
            "of manoeuvres around these": session_counts.manoeuvring,
            "of a parked car": session_counts.parked,
        }
        if session_counts.not_driven:
            texts = [f"{counted(count, 'frame')} {reason}" for reason, count in reasons.items() if count]
            parts.append(f"{printable(session)} ({', '.join(texts)})")
    if not parts:
        return []
    return [
        f"neither learnt nor held out: {first_of(parts)}; `bc-log info` lists their rows,"
        " `--labels as-recorded` keeps them"
    ]


def not_learnt_in(index: Path) -> list[str]:
    """The same line for an existing index. For an index of an earlier version: a line about its earlier rules."""
    stored = read_metadata(index / SAMPLES_NAME) or {}
    if has_earlier_rules(stored):
        flag = "" if index.name == "index" else f" --index {shlex.quote(str(index))}"
        return [f"{index}: {EARLIER_RULES}; `bc-index{flag}` leaves these out"]
    try:
        return not_learnt_line(msgspec.convert(stored["counts"], dict[str, SessionCounts]))
    except (KeyError, TypeError, ValueError):
        return []


def has_earlier_rules(metadata: Mapping[str, Any]) -> bool:
    """True if an earlier version built the index with this metadata of samples, and left out fewer frames, or used
    them for validation."""
    try:
        labels = metadata.get("labels", {})
        kept = {session for session, stored in labels.items() if not stored["plan"]["without_crashes"]}
        return any("not_measured" not in count for name, count in metadata["counts"].items() if name not in kept)
    except (KeyError, TypeError, AttributeError):
        return False
