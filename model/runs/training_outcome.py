"""The outcome of a training, in words: what natural answers change, and why which epoch is kept."""

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
    """The error that decides which epoch is kept: the smallest. In degrees, except the driving error."""
    if keep == "driving-error":
        return measures.driving_error
    return measures.balanced_rmse_deg if keep == "balanced-rmse" else measures.network.rmse_deg


def outcome_lines(epochs: Sequence[Epoch], kept: int, keep: Keep = "balanced-rmse") -> list[str]:
    """A line for the scale of the answers of epoch `kept`, and one if another epoch had the smaller RMSE; none if
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

    least = min((epoch for epoch in epochs if math.isfinite(rmse_deg(epoch))), key=rmse_deg, default=best)
    if not rmse_deg(least) < rmse_deg(best):
        return []
    shown = best.measures.unit.of
    other = (
        f"epoch {least.epoch:,} for its RMSE ({shown(rmse_deg(least)):.2f} against {shown(rmse_deg(best)):.2f})"
    )
    if keep == "last":
        return [f"epoch {best.epoch:,} is kept as the last one (--keep last) and not {other}"]
    of_best, of_least = (error_to_keep_by(keep, epoch.measures) for epoch in (best, least))
    if keep == "balanced-rmse":
        of_best, of_least = shown(of_best), shown(of_least)
    return [
        f"epoch {best.epoch:,} is kept for its {_NAMES[keep]} ({of_best:.2f} against {of_least:.2f})"
        f" and not {other}, which says little about bends where most of the road is straight"
    ]
