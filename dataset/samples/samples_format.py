"""`index/samples.parquet`: its name, version, columns, metadata and parts, on which writers and readers agree."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path, PurePath
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common.location import Location
from dataset.parquet_file import read_metadata
from recorder.rows.label_plan import LabelPlan
from recorder.rows.steering_habits import SteeringHabits, SteeringLag

SAMPLES_NAME: Final = "samples.parquet"

SAMPLES_FORMAT: Final = 5
DIVIDED_FORMAT: Final = 6
READABLE_FORMATS: Final = (4, 5, 6)
"""4 has no labels of other targets than steering; 6 has its samples in files beside it, one a session."""

SAMPLES_FOLDER: Final = "samples"
"""The folder of divided samples, with one for each digest; `samples.parquet` then has no rows."""

DIVIDED_FROM_FRAMES: Final = 100_000_000
"""From so many frames on samples are divided: in one file, they would take the driver 12 GB and minutes."""

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
        pa.field(
            "later_speed_mph", pa.float64()
        ),  # that was driven --speed-ahead seconds later; null: nobody knows
        pa.field("throttle", pa.float64()),  # less the brake: -1..1; null: nobody knows
    ]
)


_DIGEST: Final = re.compile("[0-9a-f]{64}")
_FOLDER_OF_DIGEST: Final = re.compile("[0-9a-f]{16}")


@dataclass(frozen=True)
class Division:
    """The division of samples into files.

    Their folder is named by what they were made from: new ones are there, whole, beside the old ones, before
    `samples.parquet` names them.
    """

    digest: str  # SHA-256 of what all of them were made from, which each of them has, too
    sessions: tuple[str, ...]  # that have samples, in the order of these

    def folder(self, index: Location) -> Location:
        return index / SAMPLES_FOLDER / self.digest[:16]

    def places(self, index: Location) -> list[Location]:
        return [self.folder(index) / f"{session}.parquet" for session in self.sessions]

    @classmethod
    def of(cls, metadata: Mapping[str, Any]) -> Division | None:
        """None if all samples are in one file. Raises KeyError, TypeError or ValueError for other metadata."""
        if "parts" not in metadata:
            return None
        digest, sessions = str(metadata["parts"]["digest"]), tuple(map(str, metadata["parts"]["sessions"]))
        if not _DIGEST.fullmatch(digest) or any(PurePath(name).name != name for name in sessions):
            raise ValueError("parts whose names lead elsewhere")
        return cls(digest, sessions)


def folders_of_parts(index: Path) -> list[Path]:
    """The folders of divided samples that are there, of whatever digest."""
    try:
        paths = sorted((index / SAMPLES_FOLDER).iterdir())
    except OSError:
        return []
    return [path for path in paths if _FOLDER_OF_DIGEST.fullmatch(path.name) and not path.is_symlink()]


def sample_files(index: Path) -> list[Path]:
    """The files that hold the samples of an index, in their order. Raises what `Division.of` does."""
    parts = Division.of(read_metadata(index / SAMPLES_NAME) or {})
    return [index / SAMPLES_NAME] if parts is None else [Path(str(place)) for place in parts.places(index)]


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
        """Raises KeyError, TypeError or ValueError if it is none."""
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
