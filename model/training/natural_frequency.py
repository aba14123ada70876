"""Training frames at nearly their frequency on the road, to which the answer scale is fitted.

Frames held out are not used.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from dataset import Loader, Samples
from dataset.picture_spec import PictureSpec
from dataset.prediction_targets import steering_in
from dataset.samples.samples_reader import LOADED
from model.evaluation.predict import predict
from model.network.picture_network import PictureNetwork
from model.runs.answer_scale import AnswerScale

MAX_FRAMES: Final = 1000
"""Enough to fit three numbers. They take a hundredth of the time of an epoch of 30,000 samples."""

TOWARDS_BALANCE: Final = 0.25
"""The mix of the frequency of the road (0), which has few hard bends, and that of equal bins (1). At 0, answers
have the smallest error, but the car drives hairpins wide or leaves the road: see
docs/studies/natural-answers.md."""

_COLUMNS: Final = (*LOADED, "camera", "bin", "copy")


class NaturalFrames:
    """Unaltered training frames and their mirror images, at nearly their frequency on the road.

    With the mirror images, left and right are equally frequent: the offset corrects the network, not the direction
    of the track.
    """

    def __init__(
        self, samples: Samples, batch: int, threads: int, picture: PictureSpec, *, keeps_pictures: bool = False
    ) -> None:
        """`keeps_pictures` decodes pictures once, not in every epoch, and takes up to 50 MB at the default
        size."""
        frames = _at_natural_frequency(samples)
        budget_bytes = len(frames) * picture.size_bytes if keeps_pictures else 0
        self.loader = Loader(
            samples, frames, batch=batch, budget_bytes=budget_bytes, threads=threads, seen=picture
        )

    def fit(self, network: PictureNetwork) -> AnswerScale:
        """The scale for a network's answers, fitted to these frames. Frames with NaN answers are ignored."""
        answers, labels = predict(network, self.loader)
        learnt = steering_in(answers)
        is_number = np.isfinite(learnt)
        return AnswerScale.fit(learnt[is_number], labels[is_number])


def _at_natural_frequency(samples: Samples) -> pa.Table:
    """At most `MAX_FRAMES` originals of the centre camera; of all cameras if the centre camera has none.

    Balancing leaves a random part of each bin, so each remaining original represents others of its bin.
    """
    before = samples.balance.before
    training = samples.of_split("train", _COLUMNS)
    originals = np.flatnonzero(~np.asarray(training["copy"]))
    bins = training["bin"].to_numpy()[originals]
    is_center = np.asarray(pc.equal(training["camera"].cast(pa.string()), "center"))[originals]
    if len(bins) and not 0 <= bins.min() <= bins.max() < len(before):
        raise samples.damaged("a bin that its balance lacks")
    bin_counts = np.bincount(bins, minlength=len(before))
    weight = (before ** (1 - TOWARDS_BALANCE) / np.maximum(bin_counts, 1))[bins]
    weight = np.where(is_center, weight, 0.0) if is_center.any() else weight
    count = min(MAX_FRAMES, int(np.count_nonzero(weight)))
    quantiles = (np.arange(count) + 0.5) / count * weight.sum()
    at = np.minimum(np.searchsorted(np.cumsum(weight), quantiles), len(bins) - 1)
    return training.take(originals[at])
