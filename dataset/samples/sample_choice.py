"""Choose the samples: the frames of a session that no rule leaves out, the number of samples in each steering bin,
their mirror images, and the alterations of the copies.

Most driving is straight ahead: without balancing, a network that always predicts 0 has small errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common.car import CAMERAS
from dataset.config import IndexConfig
from dataset.frames.drivers import DRIVERS, is_taken
from dataset.frames.frame_flags import is_excluded, is_unusable
from dataset.frames.frames_file import SPLITS, codes
from dataset.samples.labels import planned_labels
from dataset.samples.samples_format import Balance, SessionCounts, SessionLabels
from dataset.steering_bins import bin_of
from recorder.rows.causes import NOT_LEARNT
from recorder.rows.condition import lists_with, rows_where


@dataclass(frozen=True)
class FrameChoice:
    """The choice among the N frames of a session, before balancing; arrays (N,)."""

    is_chosen: NDArray[np.bool_]
    is_training: NDArray[np.bool_]  # a chosen frame that is not for training is for validation
    steering: NDArray[np.float64]  # the steering to learn, for the centre camera
    counts: SessionCounts


def choose_frames(frames: pa.Table, config: IndexConfig, labels: SessionLabels) -> FrameChoice:
    """Choose frames by the settings. Raises UsageError if `config.where` is no condition on their columns."""
    split = codes(frames["split"], SPLITS)
    split = np.where((split == 1) & np.isin(frames["row"].to_numpy(), labels.shared_rows), 2, split)
    is_bad = is_unusable(frames)
    is_tagged = is_excluded(frames)
    camera = codes(frames["camera"], CAMERAS)
    is_selected = np.isin(camera, [CAMERAS.index(name) for name in config.cameras])
    if config.where is not None:
        is_selected &= rows_where(frames, config.where)
    is_wanted = is_selected & is_taken(codes(frames["driver"], DRIVERS), config.drives)
    steering, is_odd = planned_labels(frames, labels.plan)
    usable = is_wanted & ~is_bad & ~is_tagged
    has_label = ~np.isnan(steering)
    is_left_out = is_odd & (split != 2)
    left_out = dict[str, int]()
    is_open = usable & is_left_out
    not_measured = int((is_open & (split == 1)).sum())
    for flag in NOT_LEARNT:
        is_flagged = is_open & lists_with(frames["flags"], flag)
        left_out[flag] = int(is_flagged.sum())
        is_open &= ~is_flagged
    chosen = usable & has_label & (split != 2) & ~is_left_out
    counts = SessionCounts(
        frames=len(frames),
        training=int((chosen & (split == 0)).sum()),
        validation=int((chosen & (split == 1)).sum()),
        gap=int((usable & (split == 2)).sum()),
        excluded=int((is_wanted & is_tagged).sum()),
        unusable=int((is_wanted & is_bad & ~is_tagged).sum()),
        unlabelled=int((usable & ~has_label & (split != 2) & ~is_left_out).sum()),
        not_asked_for=int((~is_selected).sum()),
        crashed=left_out["crash"],
        not_taken_over=int((is_selected & ~is_wanted).sum()),
        backwards=left_out["backwards"],
        manoeuvring=left_out["manoeuvring"],
        parked=left_out["parked"],
        not_measured=not_measured,
    )
    return FrameChoice(chosen, split == 0, steering, counts)


PerBin = Literal["mean", "median"] | int


@dataclass(frozen=True)
class Balanced:
    """The chosen candidates: their positions, and whether each is a copy of another one."""

    chosen: NDArray[np.int64]
    is_copy: NDArray[np.bool_]
    per_bin: int  # target for every bin; 0: not balanced
    short: dict[int, int]  # missing samples of each bin that `max_uses` kept below the target


def balance(
    bin_index: NDArray[Any], bins: int, max_uses: int, random: np.random.Generator, per_bin: PerBin = "mean"
) -> Balanced:
    """Bring every non-empty bin to the same number of samples: the mean of the bins, their median, or a number.

    A larger bin is reduced at random. A smaller bin is filled with copies, distributed evenly over its originals.
    An original is used at most `max_uses` times, including itself.
    """
    counts = np.bincount(bin_index, minlength=bins)
    filled = np.flatnonzero(counts)
    target = _target(counts[filled], per_bin) if len(filled) else 0
    chosen: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
    is_copy: list[NDArray[np.bool_]] = [np.zeros(0, np.bool_)]
    short: dict[int, int] = {}
    # 16 bits are enough for all bins, and NumPy's stable sort of 16-bit integers takes linear time
    order = np.argsort(bin_index.astype(np.int16), kind="stable")
    ends = np.cumsum(counts)
    for index in filled.tolist():
        members = order[ends[index] - counts[index] : ends[index]]
        originals = members if len(members) <= target else np.sort(random.choice(members, target, replace=False))
        copied = min(target, len(originals) * max_uses) - len(originals)
        rounds = [random.permutation(originals) for _ in range(-(-copied // len(originals)))]
        copies = np.concatenate([*rounds, originals[:0]])[:copied]
        chosen += [originals, copies]
        is_copy += [np.zeros(len(originals), np.bool_), np.ones(len(copies), np.bool_)]
        if lacking := target - len(originals) - copied:
            short[index] = lacking
    return Balanced(np.concatenate(chosen), np.concatenate(is_copy), target, short)


def _target(counts: NDArray[np.int64], per_bin: PerBin) -> int:
    if per_bin == "mean":
        return round(float(counts.mean()))
    if per_bin == "median":
        return round(float(np.median(counts)))
    return int(per_bin)


@dataclass(frozen=True)
class ChosenSamples:
    """Samples in the order of the file; arrays of the same length."""

    frame: NDArray[np.int64]  # position among the usable frames of all sessions
    flip: NDArray[np.bool_]
    is_copy: NDArray[np.bool_]
    alteration: NDArray[np.int8]  # bit i: `config.alterations[i]`
    seed: NDArray[np.int64]

    def between(self, start: int, end: int) -> ChosenSamples:
        return ChosenSamples(*(column[start:end] for column in vars(self).values()))


def choose_samples(
    label: NDArray[np.float64], is_training: NDArray[np.bool_], config: IndexConfig
) -> tuple[ChosenSamples, Balance]:
    """Choose the frames that become samples, the number of copies, and the alterations of the copies.

    A candidate is a frame or its mirror image; its number is frame + flip * frames.
    """
    random = np.random.default_rng(config.seed)
    bins, is_training = _candidates(label, is_training, config)
    training = np.flatnonzero(is_training)
    if config.balance:
        balanced = balance(bins[training], config.bins, config.max_uses, random, config.per_bin)
    else:
        balanced = Balanced(np.arange(len(training)), np.zeros(len(training), np.bool_), 0, {})
    before = np.bincount(bins[training], minlength=config.bins)
    candidate = training[balanced.chosen]
    after = np.bincount(bins[candidate], minlength=config.bins)
    validation = np.flatnonzero(~is_training)  # each validation candidate once
    candidate = np.concatenate([candidate, validation])
    is_copy = np.concatenate([balanced.is_copy, np.zeros(len(validation), np.bool_)])
    per_bin, short = balanced.per_bin, balanced.short
    del training, balanced, bins, is_training  # half a gigabyte for ten million frames
    return _in_order(candidate, is_copy, len(label), config, random), Balance(before, after, per_bin, short)


def _candidates(
    label: NDArray[np.float64], is_training: NDArray[np.bool_], config: IndexConfig
) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
    """The bin of each candidate, and a mask of the candidates for training."""
    bins = bin_of(label, config.bins).astype(np.int16)
    if not config.flip:
        return bins, is_training
    bins = np.concatenate([bins, config.bins - 1 - bins])
    middle = np.concatenate([label == 0, label == 0])
    bins[middle] = bin_of(np.zeros(1), config.bins)[0]  # a label of 0 stays in its bin when mirrored
    return bins, np.concatenate([is_training, is_training])


def _in_order(
    candidate: NDArray[np.int64],
    is_copy: NDArray[np.bool_],
    frames: int,
    config: IndexConfig,
    random: np.random.Generator,
) -> ChosenSamples:
    """Sort the samples by frame, then original before mirror image, then copies last; draw the copies'
    alterations."""
    key = (candidate % frames) * 4 + (candidate // frames) * 2 + is_copy  # frame, flip and is_copy in one integer
    key.sort()
    is_copy = (key & 1) > 0
    alteration, seed = _alterations(is_copy, config, random)
    return ChosenSamples(key >> 2, (key & 2) > 0, is_copy, alteration, seed)


def _alterations(
    is_copy: NDArray[np.bool_], config: IndexConfig, random: np.random.Generator
) -> tuple[NDArray[np.int8], NDArray[np.int64]]:
    """The bits of the alterations and the seed of each sample; 0 for originals."""
    copies = np.flatnonzero(is_copy)
    alteration = np.zeros(len(is_copy), np.int8)
    for bit in range(len(config.alterations)):
        alteration[copies[random.random(len(copies)) < 0.5]] |= 1 << bit
    seed = np.zeros(len(is_copy), np.int64)
    seed[copies] = random.integers(0, 2**32, len(copies))
    return alteration, seed
