"""Flags of unusual frames, in the column `flags` of a session's frames table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common.car import Camera
from recorder.log.tags import EXCLUDE
from recorder.rows.condition import lists_with
from recorder.rows.row_quality import States
from recorder.rows.steering_habits import LagFinding

Stretches = tuple[tuple[int, int], ...]
"""First and last position of each stretch, in ascending order and without overlap."""


@dataclass(frozen=True)
class ImageFindings:
    """The results of decoding all pictures of a log."""

    pictures: int  # number of checked pictures
    broken: Mapping[Camera, Stretches]  # positions among a camera's pictures (`Log.pictures`)
    frozen: Mapping[Camera, Stretches]
    against: Stretches | None = None  # positions of vehicle states; None: checked by an earlier version
    lag: LagFinding | None = None  # of the steering; None: labels need none, or checked by an earlier version


@dataclass(frozen=True)
class Paired:
    """The frames of one camera: positions (N,) of their vehicle states and of their pictures (`Log.pictures`)."""

    state: NDArray[np.int64]
    picture: NDArray[np.int64]


def frame_flags(states: States, frames: Mapping[Camera, Paired], findings: ImageFindings | None) -> pa.ListArray:
    """The flags of each frame, as lists of strings, for the frames of all cameras one after the other.

    - all flags of rows (`States.flags`)
    - `missing_picture`: its row lacks the picture of another camera of the session
    - only with `findings`: `broken_picture` (does not decode), `frozen_picture` (one of at least three equal
      pictures in a row, while the car moves), and `steering_against_pictures`
    """
    flags: dict[str, NDArray[np.bool_]] = {
        flag: _joined(mask[paired.state] for paired in frames.values()) for flag, mask in states.flags.items()
    }
    lacks = _lacks_a_picture(len(states.row), frames)
    flags["missing_picture"] = _joined(lacks[paired.state] for paired in frames.values())
    if findings is not None:
        of_pictures: dict[str, Mapping[Camera, Stretches]] = {
            "broken_picture": findings.broken,
            "frozen_picture": findings.frozen,
        }
        for flag, stretches in of_pictures.items():
            flags[flag] = _joined(
                _is_within(paired.picture, stretches.get(camera, ())) for camera, paired in frames.items()
            )
        against = findings.against or ()
        flags["steering_against_pictures"] = _joined(
            _is_within(paired.state, against) for paired in frames.values()
        )
    return _lists(flags, sum(len(paired.state) for paired in frames.values()))


def is_unusable(frames: pa.Table) -> NDArray[np.bool_]:
    """A mask of the frames that cannot be used: steering outside -1..1, or the picture does not decode."""
    unusable: NDArray[np.bool_] = frames["bin"].to_numpy() < 0
    return unusable | lists_with(frames["flags"], "broken_picture")


def _lacks_a_picture(rows: int, frames: Mapping[Camera, Paired]) -> NDArray[np.bool_]:
    lacks = np.zeros(rows, np.bool_)
    for paired in frames.values():
        if len(paired.state):
            has_one = np.zeros(rows, np.bool_)
            has_one[paired.state] = True
            lacks |= ~has_one
    return lacks


def _is_within(positions: NDArray[np.int64], stretches: Stretches) -> NDArray[np.bool_]:
    if not stretches:
        return np.zeros(len(positions), np.bool_)
    first, last = np.array(stretches, np.int64).T
    nearest = np.searchsorted(first, positions, side="right") - 1  # the last stretch that begins before
    is_within: NDArray[np.bool_] = (nearest >= 0) & (positions <= last[nearest])
    return is_within


def _joined(masks: Iterable[NDArray[np.bool_]]) -> NDArray[np.bool_]:
    return np.concatenate([np.zeros(0, np.bool_), *masks])


def _lists(flags: Mapping[str, NDArray[np.bool_]], frames: int) -> pa.ListArray:
    """Convert masks (N,) to one list of names for each frame. Frames without a flag only take an offset."""
    at: list[NDArray[np.int64]] = [np.flatnonzero(mask) for mask in flags.values()]
    frame = np.concatenate([np.zeros(0, np.int64), *at])
    name = np.repeat(np.arange(len(at), dtype=np.int8), [len(part) for part in at])
    name = name[np.argsort(frame, kind="stable")]
    offsets = np.zeros(frames + 1, np.int32)
    np.cumsum(np.bincount(frame, minlength=frames), out=offsets[1:])
    names: Any = pa.DictionaryArray.from_arrays(name, pa.array(flags, pa.string()))
    return pa.ListArray.from_arrays(offsets, names.cast(pa.string()))


def is_excluded(frames: pa.Table) -> NDArray[np.bool_]:
    return lists_with(frames["tags"], EXCLUDE)
