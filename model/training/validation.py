"""The validation after each epoch: the network's errors on the frames held out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from common.errors import counted
from dataset import Loader, Samples
from dataset.frames.distinct_rows import by_session
from dataset.picture_spec import PictureSpec
from dataset.prediction_targets import steering_in
from dataset.samples.samples_reader import LOADED
from model.config import TrainConfig
from model.evaluation.predict import predict
from model.metrics import Measures, measure, other_targets
from model.network.picture_network import PictureNetwork
from model.runs.answer_scale import AnswerScale
from model.runs.checkpoint import Position
from model.runs.run_folder import load_config
from model.runs.training_progress import Epoch, error_to_keep_by
from model.runs.worst_pictures import WORST_COLUMNS, WorstPictures, find_worst

Floats = NDArray[np.float64]


class Validation:
    """The frames held out: centre camera, unmirrored, unaltered. There may be none."""

    def __init__(
        self, samples: Samples, batch: int, budget_bytes: int, config: TrainConfig, picture: PictureSpec
    ) -> None:
        self._config = config
        self._max_deg = samples.max_steering_deg
        frames = samples.driving_view("validation")
        self.loader = Loader(
            samples,
            frames,
            batch=batch,
            budget_bytes=budget_bytes,
            threads=config.threads,
            seen=picture,
            targets=config.targets,
        )
        self.frames = frames.select(WORST_COLUMNS)

    def __len__(self) -> int:
        return len(self.loader)

    def epoch(
        self, position: Position, learnt: Floats, predicted: Floats, recorded: Floats, answers: AnswerScale
    ) -> Epoch:
        """The losses and errors of the finished epoch of `position`. `learnt` are the network's answers,
        `predicted` the same after the scale `answers`."""
        config = self._config
        measures = measure(steering_in(predicted), steering_in(recorded), max_deg=self._max_deg)
        as_learnt = measure(steering_in(learnt), steering_in(recorded), max_deg=self._max_deg)
        return Epoch(
            position.epoch,
            position.squared_error / position.samples,
            _loss(predicted, recorded, config.target_weights) if len(recorded) else math.nan,
            measures,
            config.keep == "last" or not len(recorded) or self.error(measures) < position.best_error,
            position.seconds,
            position.samples / position.seconds,
            answers,
            as_learnt.network,
            other_targets(config.targets, predicted, recorded),
            as_learnt.driving_error if len(recorded) else math.nan,
        )

    def error(self, measures: Measures) -> float:
        """The error that chooses the best epoch; infinite if nothing is held out."""
        return error_to_keep_by(self._config.keep, measures) if measures.frames else math.inf

    def worst(self, epoch: int, predicted: Floats, recorded: Floats) -> WorstPictures | None:
        if not len(recorded):
            return None
        steering = steering_in(predicted), steering_in(recorded)
        return find_worst(epoch, self.frames, self.loader, *steering, self._max_deg)


def _loss(predicted: Floats, recorded: Floats, weights: Sequence[float]) -> float:
    """The mean squared error as in training: with several targets, the weighted sum over those with a label."""
    squares = np.square(predicted - recorded)
    if squares.ndim == 1:
        return float(np.mean(squares))
    weighted = squares * (weights or np.ones(squares.shape[1]))
    return float(np.nansum(weighted) / len(weighted))


def validation_notices(samples: Samples, validation: Validation, init: Path | None) -> list[str]:
    """A notice if no frame is held out, or if `init` has learnt from frames held out."""
    held_out = len(validation)
    settings = samples.metadata["settings"]
    if not held_out:
        if settings.get("validation_share") or settings.get("validation"):
            return [
                f"{samples.path}: no frame is held out, so the network's error is unknown; give bc-index a"
                " smaller --block-s, or whole sessions with --validation SESSION"
            ]
        return []
    if init is None:
        return []
    try:  # rebuilding the split of another training needs more packages than training does
        from model.evaluation.evaluate import count_trained_on

        count = count_trained_on(dict(by_session(validation.frames)), samples, load_config(init))
    except ImportError as error:
        return [f"{init}: whether it has learnt from the frames held out is unknown ({error})"]
    if count == 0:
        return []
    learnt = "does not record its training data" if count is None else f"has learnt from {count:,} of them"
    frames = counted(held_out, "frame")
    return [f"{samples.path}: {frames} held out, but {init} {learnt}: their errors may be too small"]


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
