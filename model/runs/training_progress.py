"""The progress of a training, as its listeners get it, and as it is kept in the run's files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final, Protocol

from common.car import MAX_STEERING_DEG
from model.metrics import Errors, Measures, TargetErrors
from model.runs.answer_scale import AnswerScale

METRICS_FILE: Final = "metrics.jsonl"
"""One line an epoch: `Epoch.as_dict`."""
STEPS_FILE: Final = "steps.jsonl"
"""One line every few batches: a `Step`."""


@dataclass(frozen=True)
class Step:
    """Progress within an epoch."""

    epoch: int  # from 1
    batch: int  # from 1, of `batches`
    batches: int
    samples: int  # learnt from since the run began, repeated ones included
    training_loss: float  # mean squared error of steering, -1..1, and of other targets, since the step before
    samples_per_s: float

    @property
    def scalars(self) -> dict[str, float]:
        """Its numbers by the names that curves have; those that exist."""
        return finite({"loss/steps": self.training_loss, "samples_per_s": self.samples_per_s})


@dataclass(frozen=True)
class Epoch:
    """The losses and errors of an epoch. What does not exist is NaN."""

    epoch: int  # from 1
    training_loss: float  # mean squared error of steering, -1..1, and of other targets, while they were learnt
    validation_loss: float  # the same of the frames held out, afterwards
    measures: Measures  # of those frames: centre camera, unmirrored, unaltered
    is_best: bool  # the best one so far
    seconds: float
    samples_per_s: float
    answers: AnswerScale = field(default_factory=AnswerScale)  # that the measures are of
    learnt: Errors | None = None  # of the answers without it; None in runs of earlier versions
    targets: tuple[TargetErrors, ...] = ()  # of those besides steering
    learnt_driving_error: float = math.nan  # of the answers without it; earlier versions have none

    @property
    def scalars(self) -> dict[str, float]:
        """Its losses and errors by the names that curves have, such as "rmse_deg/network"; those that exist."""
        measures = self.measures
        values = {
            "epoch": float(self.epoch),
            "loss/training": self.training_loss,
            "loss/validation": self.validation_loss,
            "rmse_deg/balanced": measures.balanced_rmse_deg,
        }
        for predictor in ("network", "mean", "zero"):
            errors = asdict(getattr(measures, predictor))
            values |= {f"{name}/{predictor}": value for name, value in errors.items()}
        for target in self.targets:
            values |= {
                f"{target.target}_rmse/network": target.rmse,
                f"{target.target}_rmse/mean": target.mean_rmse,
            }
        return finite(values)

    def as_dict(self) -> dict[str, Any]:
        measures = self.measures
        return {
            "epoch": self.epoch,
            "training_loss": self.training_loss,
            "validation_loss": self.validation_loss,
            "validation": asdict(measures.network),
            "zero": asdict(measures.zero),
            "mean": {**asdict(measures.mean), "balanced_rmse_deg": measures.mean_balanced_rmse_deg},
            "balanced_rmse_deg": measures.balanced_rmse_deg,
            "bins": [asdict(part) for part in measures.bins],
            **({"max_deg": measures.max_deg} if measures.max_deg != MAX_STEERING_DEG else {}),
            "answers": asdict(self.answers),
            "learnt": self.learnt and {**asdict(self.learnt), "driving_error": self.learnt_driving_error},
            **({"targets": [target.as_dict() for target in self.targets]} if self.targets else {}),
            "is_best": self.is_best,
            "seconds": self.seconds,
            "samples_per_s": self.samples_per_s,
        }


class Listener(Protocol):
    """Called with the progress of a training, which waits for it. An exception does not end the training: see
    `model.training.listeners`."""

    def step(self, step: Step) -> object:
        """Every ten batches."""

    def epoch(self, epoch: Epoch) -> object:
        """After each epoch, once its frames held out are measured and, if it is the best one, its weights kept."""

    def close(self) -> object:
        """At the end, however the training ends."""


def finite(numbers: Mapping[str, float]) -> dict[str, float]:
    return {name: float(value) for name, value in numbers.items() if math.isfinite(value)}
