"""The format of `index/samples.parquet`: name, version, columns and metadata."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recorder.rows.label_plan import LabelPlan
from recorder.rows.steering_habits import SteeringHabits, SteeringLag

SAMPLES_NAME: Final = "samples.parquet"

SAMPLES_FORMAT: Final = 5
READABLE_FORMATS: Final = (4, 5)
"""Format 4 has labels of steering only."""

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
    def not_driven(self) -> int:
        return self.crashed + self.backwards + self.manoeuvring + self.parked


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
    """The steering habits of a session, and the plan of its labels."""

    habits: SteeringHabits
    lag: SteeringLag | None  # None: not measured, or not measurable
    plan: LabelPlan
    set_speeds_mph: tuple[float, ...] = ()  # that the driver keeps where bends allow; empty for people
    shared_rows: tuple[int, ...] = ()  # rows of a standing car with pictures of another session: not held out
