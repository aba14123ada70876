"""Choose the samples: balance frames and their mirror images, and draw the alterations of the copies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dataset.config import IndexConfig
from dataset.samples.balance import Balanced, balance
from dataset.samples.samples_format import Balance
from dataset.steering_bins import bin_of


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
