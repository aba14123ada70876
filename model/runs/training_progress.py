"""The progress of a training, as listeners receive it and as the run's files store it, and its outcome."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Final, Protocol

from common.car import MAX_STEERING_DEG
from common.errors import counted, decimal
from common.output import print_result
from model.config import Keep
from model.metrics import Errors, Measures, TargetErrors
from model.runs.answer_scale import AnswerScale

if TYPE_CHECKING:
    from model.config import Keep


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
    `model.training.loop`)."""

    def step(self, step: Step) -> object:
        """Called every ten batches."""

    def epoch(self, epoch: Epoch) -> object:
        """Called after each epoch, when the frames held out are measured and the weights of a best epoch are
        saved."""

    def close(self) -> object:
        """Called when the training ends, also by an error."""


def finite(numbers: Mapping[str, float]) -> dict[str, float]:
    return {name: float(value) for name, value in numbers.items() if math.isfinite(value)}


_NAMES: Final = {"driving-error": "driving error", "balanced-rmse": "balanced RMSE"}


def error_to_keep_by(keep: Keep, measures: Measures) -> float:
    """The error that is smallest in the kept epoch. In degrees, except the driving error."""
    if keep == "driving-error":
        return measures.driving_error
    return measures.balanced_rmse_deg if keep == "balanced-rmse" else measures.network.rmse_deg


def outcome_lines(epochs: Sequence[Epoch], kept: int, keep: Keep = "balanced-rmse") -> list[str]:
    """A line for the answer scale of epoch `kept`, and a line if another epoch has a smaller RMSE. Empty if
    nothing was held out."""
    best = next((epoch for epoch in epochs if epoch.epoch == kept and epoch.measures.frames), None)
    if best is None:
        return []
    return [*_of_natural_answers(best), *_why_kept(epochs, best, keep)]


def _of_natural_answers(best: Epoch) -> list[str]:
    if best.learnt is None or best.answers == AnswerScale():
        return []
    unit = best.measures.unit
    natural, learnt = (decimal(unit.of(errors.rmse_deg), 2) for errors in (best.measures.network, best.learnt))
    formula = best.answers.in_words(best.measures.max_deg)
    return [f"natural answers: {formula}: RMSE {natural} instead of {learnt} {unit.name}"]


def _why_kept(epochs: Sequence[Epoch], best: Epoch, keep: Keep) -> list[str]:
    def rmse_deg(epoch: Epoch) -> float:
        return epoch.measures.network.rmse_deg

    smallest = min((epoch for epoch in epochs if math.isfinite(rmse_deg(epoch))), key=rmse_deg, default=best)
    if not rmse_deg(smallest) < rmse_deg(best):
        return []
    shown = best.measures.unit.of
    rmse = f"{shown(rmse_deg(smallest)):.2f} against {shown(rmse_deg(best)):.2f}"
    other = f"epoch {smallest.epoch:,} for its RMSE ({rmse})"
    if keep == "last":
        return [f"epoch {best.epoch:,} is kept because it is the last (--keep last), and not {other}"]
    best_error, other_error = (error_to_keep_by(keep, epoch.measures) for epoch in (best, smallest))
    if keep == "balanced-rmse":
        best_error, other_error = shown(best_error), shown(other_error)
    return [
        f"epoch {best.epoch:,} is kept for its {_NAMES[keep]} ({best_error:.2f} against {other_error:.2f})"
        f" and not {other}, which says little about bends where most of the road is straight"
    ]


class EpochPrinter:
    """Prints one line an epoch on stdout; before the first one, the errors of constant predictors."""

    def __init__(self, keep: Keep) -> None:
        """`keep` is how the training chooses the epoch that it keeps."""
        self._has_begun = False
        self._chooses = keep != "last"

    def step(self, step: Step) -> None:
        """Print nothing: the progress bar shows steps."""

    def epoch(self, epoch: Epoch) -> None:
        measures, unit = epoch.measures, epoch.measures.unit
        if measures.frames and not self._has_begun:
            print_result(
                f"errors of {counted(measures.frames, 'frame')} held out, in {unit.name}; always the mean: RMSE"
                f" {unit.of(measures.mean.rmse_deg):.2f}, always zero: {unit.of(measures.zero.rmse_deg):.2f}"
            )
        self._has_begun = True
        validation = (
            f" RMSE {decimal(unit.of(measures.network.rmse_deg), 2)}, balanced"
            f" {decimal(unit.of(measures.balanced_rmse_deg), 2)},"
            f" correlation {decimal(measures.network.correlation, 2)},"
            if measures.frames
            else " nothing held out,"
        )
        print_result(
            f"epoch {epoch.epoch:>2}: loss {decimal(epoch.training_loss, 4)},{validation}"
            f" {epoch.samples_per_s:,.0f} samples/s{', kept' if self._chooses and epoch.is_best else ''}"
        )
        for target in epoch.targets:
            if target.frames:
                print_result(f"          {target}")

    def close(self) -> None:
        """Nothing to close."""
