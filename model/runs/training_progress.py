"""The progress of a training, as listeners receive it and as the run's files store it."""

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
MAX_HISTORY_BYTES: Final = 32 << 20
"""Of each of these files: in a larger one, a training removes every second line. Readers refuse 64 MiB."""


@dataclass(frozen=True)
class Step:
    epoch: int  # from 1
    batch: int  # from 1, of `batches`
    batches: int
    samples: int  # learnt since the run began; repeated samples count again
    training_loss: float  # mean squared error of steering, -1..1, and of other targets, since the last Step
    samples_per_s: float

    @property
    def scalars(self) -> dict[str, float]:
        """The finite numbers of this step, by the names of curves."""
        return finite({"loss/steps": self.training_loss, "samples_per_s": self.samples_per_s})


@dataclass(frozen=True)
class Epoch:
    """The losses and errors of an epoch. NaN where a value is missing."""

    epoch: int  # from 1
    training_loss: float  # mean squared error of steering, -1..1, and of other targets, during the epoch
    validation_loss: float  # of the frames held out, after the epoch
    measures: Measures  # of the frames held out: centre camera, unmirrored, unaltered
    is_best: bool  # its weights are kept until a later epoch is better
    seconds: float
    samples_per_s: float
    answers: AnswerScale = field(default_factory=AnswerScale)  # applied before measuring
    learnt: Errors | None = None  # of the answers without the scale; None in runs of earlier versions
    targets: tuple[TargetErrors, ...] = ()  # of the targets other than steering
    learnt_driving_error: float = math.nan  # of the answers without the scale; NaN in earlier versions

    @property
    def scalars(self) -> dict[str, float]:
        """The finite losses and errors of this epoch, by the names of curves, for example "rmse_deg/network"."""
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
    """Receives the progress of a training. The training waits for it; its exceptions do not end the training (see
    `model.training.listeners`)."""

    def step(self, step: Step) -> object:
        """Called every ten batches."""

    def epoch(self, epoch: Epoch) -> object:
        """Called after each epoch, when the frames held out are measured and the weights of a best epoch are
        saved."""

    def close(self) -> object:
        """Called when the training ends, also by an error."""


def finite(numbers: Mapping[str, float]) -> dict[str, float]:
    return {name: float(value) for name, value in numbers.items() if math.isfinite(value)}
