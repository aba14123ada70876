"""The data of an index's figures: frames, draws of the alterations, and counts of samples."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from common.location import Location
from dataset.augment import alter
from dataset.config import IndexConfig
from dataset.errors import DatasetError
from dataset.picture_spec import ORIGINAL
from dataset.preprocessing import Image, decode
from dataset.samples.samples_format import Balance
from dataset.samples.samples_reader import Samples

TURN: Final = 0.1  # steering from which a frame counts as a turn: 2.5 degrees

Kind = Literal["left turn", "straight", "right turn"]


@dataclass(frozen=True)
class Moment:
    """A camera picture and how the car was steered there."""

    kind: Kind
    steering: float  # -1..1, as a sample of this camera has it
    picture: Image  # (height, width, 3) BGR


@dataclass(frozen=True)
class Distribution:
    """Training samples in each steering bin; arrays of one length, from left to right."""

    before: NDArray[np.int64]
    originals: NDArray[np.int64]  # after balancing, without
    copies: NDArray[np.int64]  # the copies that fill up
    short: NDArray[np.int64]  # what the cap on copies left missing
    per_bin: int  # what the bins were brought to; 0 where nothing was balanced


def find_moments(samples: Samples, seed: int) -> list[Moment]:
    """A left turn, a straight stretch and a right turn of the centre camera, or of all if it has no picture.

    Each is drawn from that quarter of its kind whose steering is nearest to the median: the extremes are often
    somebody's way back to the road. A kind that was never driven is missing.
    """
    table = samples.table
    is_center = pc.equal(table["camera"].cast(pa.string()), "center").to_numpy()
    usable = is_center if is_center.any() else ~is_center
    steering = np.where(table["flip"].to_numpy(), -1.0, 1.0) * table["label"].to_numpy() + 0.0  # no -0.0
    kinds: dict[Kind, NDArray[np.bool_]] = {
        "left turn": steering <= -TURN,
        "straight": np.abs(steering) < TURN,
        "right turn": steering >= TURN,
    }
    random = np.random.default_rng(seed)
    moments = []
    for kind, is_kind in kinds.items():
        members = np.flatnonzero(is_kind & usable)
        if len(members):
            distance = np.abs(steering[members] - np.median(steering[members]))
            typical = members[np.argsort(distance, kind="stable")][: -(-len(members) // 4)]
            at = int(random.choice(typical))
            moments.append(Moment(kind, float(steering[at]), _picture(samples, at)))
    if not moments:
        raise _damaged(samples.path, "no sample to show")
    return moments


def _picture(samples: Samples, at: int) -> Image:
    (row,) = samples.table.slice(at, 1).to_pylist()
    log = samples.logs.get(row["session"])
    if log is None:
        raise _damaged(samples.path, f"no log of session {row['session']}")
    try:
        return decode(log.read(row["offset"], row["length"], row["chunk"]))
    except ValueError as error:
        raise DatasetError(f"{log.path}: row {row['row']}, {row['camera']} camera: {error}") from None


def steering_distribution(samples: Samples, config: IndexConfig) -> Distribution:
    """Count the training samples; what balancing left out of them, the index has noted."""
    training = samples.of_split("train")
    is_copy, bins = (training[name].to_numpy() for name in ("copy", "bin"))
    try:
        noted = Balance.from_dict(samples.metadata["balance"])
        short = np.array([noted.short.get(i, 0) for i in range(config.bins)], np.int64)
        originals, copies = (np.bincount(bins[is_copy == copy], minlength=config.bins) for copy in (0, 1))
        if not len(noted.before) == len(originals) == len(copies) == config.bins:
            raise ValueError(f"not {config.bins} bins")
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise _damaged(samples.path, error) from None
    return Distribution(noted.before, originals, copies, short, noted.per_bin)


def crop_rows(height: int) -> tuple[int, int]:
    """The first row of a picture that the network sees, and the first below that it does not see."""
    rows = ORIGINAL.crop_slice(height)
    return rows.start, rows.stop


def two_draws(crop: Image, names: str, seed: int) -> tuple[int, int]:
    """The seeds, out of twelve, of the two draws of an alteration that differ most: they show its range."""
    drawn = {seed + i: alter(crop, names, seed + i).astype(np.int16) for i in range(12)}
    return max(
        itertools.combinations(drawn, 2), key=lambda pair: int(np.abs(drawn[pair[0]] - drawn[pair[1]]).sum())
    )


def _damaged(path: Location, what: object) -> DatasetError:
    return DatasetError(f"{path}: damaged ({what}); build it again with `bc-index`")
