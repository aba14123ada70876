"""The outcome of a training, in words: the effect of natural answers, and why an epoch is kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from common.errors import decimal
from model.config import Keep
from model.metrics import Measures
from model.runs.answer_scale import AnswerScale
from model.runs.training_progress import Epoch

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
