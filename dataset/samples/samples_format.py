"""The format of `index/samples.parquet`: name, version, columns and metadata."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common.errors import counted, first_of, printable
from dataset.parquet_file import read_metadata
from recorder.rows.causes import CAUSES, NOT_LEARNT
from recorder.rows.label_plan import LabelPlan
from recorder.rows.steering_habits import SteeringHabits, SteeringLag

SAMPLES_NAME: Final = "samples.parquet"

SAMPLES_FORMAT: Final = 5
READABLE_FORMATS: Final = (4, 5)  # format 4 has labels of steering only

SAMPLES_SCHEMA: Final = pa.schema(
    [
        pa.field("session", pa.string()),
        pa.field("row", pa.int64()),
        pa.field("camera", pa.string()),
        pa.field("log_time_ns", pa.int64()),
        pa.field("offset", pa.int64()),
        pa.field("length", pa.int64()),
        pa.field("chunk", pa.int64()),
        pa.field("flip", pa.bool_()),
        pa.field("alteration", pa.string()),  # "", or names joined by "+"
        pa.field("seed", pa.int64()),  # of the alteration
        pa.field("label", pa.float64()),  # steering to learn, for this camera and mirrored if `flip`: -1..1
        pa.field("recorded", pa.float64()),  # the recorded steering, for this camera and mirrored if `flip`
        pa.field("bin", pa.int64()),
        pa.field("split", pa.string()),
        pa.field("copy", pa.bool_()),  # added to fill its bin
        pa.field("later_speed_mph", pa.float64()),  # the speed --speed-ahead seconds later; null: unknown
        pa.field("throttle", pa.float64()),  # minus the brake: -1..1; null: unknown
    ]
)


@dataclass(frozen=True)
class Balance:
    """Samples per steering bin of the training split, before and after balancing."""

    before: NDArray[np.int64]
    after: NDArray[np.int64]
    per_bin: int  # target for every bin; 0: not balanced
    short: dict[int, int]  # missing samples of each bin that `--max-uses` kept below the target

    def as_dict(self) -> dict[str, Any]:
        return {**asdict(self), "before": self.before.tolist(), "after": self.after.tolist()}

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> Balance:
        """The inverse of `as_dict`. Raises KeyError, TypeError or ValueError for an invalid dictionary."""
        before, after = (np.array(stored[name], np.int64) for name in ("before", "after"))
        if before.ndim != 1 or before.shape != after.shape or not len(before) or (before < 0).any():
            raise ValueError("not two counts of the same bins")
        short = {int(key): int(value) for key, value in stored["short"].items()}
        return cls(before, after, int(stored["per_bin"]), short)


@dataclass(frozen=True)
class SessionCounts:
    """The number of frames of a session by their use."""

    frames: int
    training: int
    validation: int
    gap: int  # between training and validation
    excluded: int  # tagged `exclude`
    unusable: int  # steering outside -1..1, or a broken picture
    unlabelled: int  # too near the end of a stretch for --label-shift
    not_asked_for: int  # another camera, or not chosen by --where
    crashed: int  # in a crash: left out of training and validation
    not_taken_over: int  # with --drives takeovers: driven neither by an expert nor by a human
    backwards: int = 0  # left out as well: the car drives backwards
    manoeuvring: int = 0  # left out as well: before and after a crash, or after driving backwards
    parked: int = 0  # left out as well: the car stands for long
    not_measured: int | None = None  # frames of these four kinds in blocks for validation; None: earlier version

    @property
    def not_learnt(self) -> dict[str, int]:
        counts = (self.crashed, self.backwards, self.manoeuvring, self.parked)
        return dict(zip(NOT_LEARNT, counts, strict=True))

    @property
    def not_driven(self) -> int:
        return sum(self.not_learnt.values())


COUNT_HEADINGS: Final = {
    "not_asked_for": "not asked for",
    "unlabelled": "no label",
    "crashed": "crash",
    "not_taken_over": "not taken over",
    "not_measured": "not measured",
}
"""Headings of the counts whose heading is not their name."""


@dataclass(frozen=True)
class SessionLabels:
    habits: SteeringHabits
    lag: SteeringLag | None  # None: not measured, or not measurable
    plan: LabelPlan
    set_speeds_mph: tuple[float, ...] = ()  # that the driver keeps where bends allow; empty for people
    shared_rows: tuple[int, ...] = ()  # rows of a standing car with pictures of another session: not held out


EARLIER_RULES: Final = "built by an earlier version, which held out crashes and did not detect all odd frames"


def not_learnt_line(counts: Mapping[str, SessionCounts]) -> list[str]:
    """A line if frames are left out because they are not normal driving: the number in each session, and why."""
    parts = []
    for session, session_counts in counts.items():
        texts = [
            f"{counted(count, 'frame')} of {CAUSES[name].of_frames}"
            for name, count in session_counts.not_learnt.items()
            if count
        ]
        if texts:
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
