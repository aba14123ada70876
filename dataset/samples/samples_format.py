"""`index/samples.parquet`: its name, version, columns and metadata, on which writers and readers agree."""

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
"""4 has no labels of other targets than steering."""

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
        pa.field("label", pa.float64()),  # steering to be learnt, of this camera and this side: -1..1
        pa.field("recorded", pa.float64()),  # the same as it was driven
        pa.field("bin", pa.int64()),
        pa.field("split", pa.string()),
        pa.field("copy", pa.bool_()),  # added to fill up its bin
        pa.field("later_speed_mph", pa.float64()),  # driven --speed-ahead seconds later; null: unknown
        pa.field("throttle", pa.float64()),  # less the brake: -1..1; null: unknown
    ]
)


@dataclass(frozen=True)
class Balance:
    """Samples per steering bin of the training split, before and after balancing."""

    before: NDArray[np.int64]
    after: NDArray[np.int64]
    per_bin: int  # what the bins were brought to; 0 where nothing was balanced
    short: dict[int, int]  # bins that the cap left below it, and how many samples they lack

    def as_dict(self) -> dict[str, Any]:
        return {**asdict(self), "before": self.before.tolist(), "after": self.after.tolist()}

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> Balance:
        """Raises KeyError, TypeError or ValueError for a dictionary that `as_dict` does not give."""
        before, after = (np.array(stored[name], np.int64) for name in ("before", "after"))
        if before.ndim != 1 or before.shape != after.shape or not len(before):
            raise ValueError("not two counts of the same bins")
        short = {int(key): int(value) for key, value in stored["short"].items()}
        return cls(before, after, int(stored["per_bin"]), short)


@dataclass(frozen=True)
class SessionCounts:
    """Frames of a session, by what becomes of them."""

    frames: int
    training: int
    validation: int
    gap: int  # between the two
    excluded: int  # tagged so
    unusable: int  # steering out of range, or a broken picture
    unlabelled: int  # so near the end of a stretch that --label-shift finds no steering for it
    not_asked_for: int  # another camera, or not what --where chooses
    crashed: int  # of a crash: neither learnt nor measured by, whatever their side of the split
    not_taken_over: int  # of a drive, and driven neither by an expert nor by a human, with --drives takeovers
    backwards: int = 0  # as crashed: the car drives backwards
    manoeuvring: int = 0  # as crashed: the way into a crash, and out of it or of driving backwards
    parked: int = 0  # as crashed: it stands for long
    not_measured: int | None = None  # of these four: held out otherwise; None: earlier versions held them out

    @property
    def not_driven(self) -> int:
        return self.crashed + self.backwards + self.manoeuvring + self.parked


COUNT_HEADINGS: Final = {
    "not_asked_for": "not asked for",
    "unlabelled": "no label",
    "crashed": "crash",
    "not_taken_over": "not taken over",
}
"""What counts are called where they are read, if not by their names."""


@dataclass(frozen=True)
class SessionLabels:
    """The steering habits of a session, and the plan of its labels."""

    habits: SteeringHabits
    lag: SteeringLag | None  # None: not measured, or nothing to measure it by
    plan: LabelPlan
    set_speeds_mph: tuple[float, ...] = ()  # that the driver was to keep where bends allow; of people, none
    shared_rows: tuple[int, ...] = ()  # of a standing car, whose pictures another session has, too: not held out
