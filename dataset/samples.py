"""`index/samples.parquet`: the balanced index that training reads, one row a sample."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from dataset.balance import balance, bin_of
from dataset.config import IndexConfig
from recorder.tags import EXCLUDE

SCHEMA: Final = pa.schema(
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
        pa.field("label", pa.float64()),  # steering, of this camera and this side: -1..1
        pa.field("bin", pa.int64()),
        pa.field("split", pa.string()),
        pa.field("copy", pa.bool_()),  # added to fill up its bin
    ]
)


FROM_FRAMES: Final = ("session", "row", "camera", "log_time_ns", "offset", "length", "chunk", "split")


@dataclass(frozen=True)
class Balance:
    """Samples per steering bin of the training split, before and after balancing."""

    before: NDArray[np.int64]
    after: NDArray[np.int64]
    per_bin: int
    short: dict[int, int]


def is_excluded(frames: pa.Table) -> pa.ChunkedArray:
    """Which frames somebody has tagged `exclude`."""
    tagged = pc.list_parent_indices(frames["tags"].combine_chunks())
    names = pc.list_flatten(frames["tags"].combine_chunks())
    mask = np.zeros(len(frames), np.bool_)
    mask[tagged.filter(pc.equal(names, EXCLUDE)).to_numpy()] = True
    return pa.chunked_array([pa.array(mask)])


def samples_table(frames: pa.Table, config: IndexConfig) -> tuple[pa.Table, Balance]:
    """Frames (see `frames.SCHEMA`) as samples: mirrored, labelled, and the training split balanced.

    Validation holds every picture and its mirror image once, unaltered. A frame whose steering is out of
    range cannot be binned and is left out; so is one that somebody has tagged `exclude`.
    """
    usable = pc.and_(pc.is_in(frames["camera"], pa.array(config.cameras)), pc.greater_equal(frames["bin"], 0))
    frames = frames.filter(pc.and_(usable, pc.invert(is_excluded(frames)))).combine_chunks()
    camera = frames["camera"].to_numpy()
    correction = config.side_correction * ((camera == "left").astype(float) - (camera == "right"))
    straight = np.clip(frames["steering"].to_numpy() + correction, -1.0, 1.0)

    flips = (False, True) if config.flip else (False,)
    frame = np.tile(np.arange(len(frames)), len(flips))
    flip = np.repeat(flips, len(frames))
    label = np.concatenate([-straight if flipped else straight for flipped in flips]) + 0.0  # no -0.0
    bins = bin_of(label, config.bins)
    is_training = frames["split"].to_numpy()[frame] == "train"

    random = np.random.default_rng(config.seed)
    training = np.flatnonzero(is_training)
    balanced = balance(bins[training], config.bins, config.max_uses, random)
    validation = np.flatnonzero(~is_training)
    chosen = np.concatenate([training[balanced.chosen], validation])
    is_copy = np.concatenate([balanced.is_copy, np.zeros(len(validation), np.bool_)])
    order = np.lexsort((is_copy, flip[chosen], frame[chosen]))
    chosen, is_copy = chosen[order], is_copy[order]
    alteration, seed = _alterations(is_copy, config, random)

    taken = frames.take(pa.array(frame[chosen]))
    columns = {
        **{name: taken[name] for name in FROM_FRAMES},
        "flip": flip[chosen],
        "alteration": alteration,
        "seed": seed,
        "label": label[chosen],
        "bin": bins[chosen],
        "copy": is_copy,
    }
    table = pa.table({field.name: columns[field.name] for field in SCHEMA}, schema=SCHEMA)
    return table, Balance(
        np.bincount(bins[training], minlength=config.bins),
        np.bincount(bins[training][balanced.chosen], minlength=config.bins),
        balanced.per_bin,
        balanced.short,
    )


def _alterations(
    is_copy: NDArray[np.bool_], config: IndexConfig, random: np.random.Generator
) -> tuple[NDArray[np.object_], NDArray[np.int64]]:
    """For each sample the names of its alterations and their seed; an original has none."""
    drawn = random.random((len(is_copy), len(config.alter))) < 0.5
    seed = random.integers(0, 2**32, len(is_copy))
    names = [
        "+".join(np.array(config.alter)[row]) if copy else "" for row, copy in zip(drawn, is_copy, strict=True)
    ]
    return np.array(names, dtype=object), np.where(is_copy, seed, 0)
