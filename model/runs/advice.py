"""The one thing most likely to help a network. The rule most likely to help comes first.

Each rule is a function of a run's numbers. It returns advice with the numbers that call for it, or None.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from common.errors import counted, printable
from model.config import ENOUGH_STEPS
from model.runs.answer_scale import AnswerScale
from model.runs.run_numbers import RunNumbers

FEW_FRAMES: Final = 300
"""Half a minute at ten frames a second: six blocks of 5 s, within which errors are alike. Fewer blocks give no
reliable interval (`model.evaluation.differences`)."""
STILL_IMPROVING: Final = 0.02
"""Relative fall of the driving error in the last epoch that calls for more epochs."""
FEW_TURNS: Final = 500
FEW_OF_A_SIDE: Final = 0.1
WORSE_ANSWERS: Final = 0.1
"""How much the driving error of natural answers may exceed that of the answers as learnt. Networks whose natural
answers were worse by 0.06 drove as well with both (docs/studies/speedrun.md)."""


@dataclass(frozen=True)
class Advice:
    """The next thing to do: the reason with its numbers, and a command to paste."""

    why: str
    command: str


def advice(numbers: RunNumbers) -> Advice:
    return next(advised for rule in RULES if (advised := rule(numbers)) is not None)


def is_being_trained(numbers: RunNumbers) -> Advice | None:
    if not numbers.is_training:
        return None
    return Advice(f"it is being trained, {counted(numbers.learnt, 'epoch')} are learnt", "bc-web --open")


def has_wrong_labels(numbers: RunNumbers) -> Advice | None:
    """The steering is mirrored, of another scale, or missing: a network learns it wrongly."""
    for name, labels in numbers.data.labels.items():
        check = f"bc-log check {numbers.log_of(name)}"
        session, kind = printable(name), labels.habits.kind
        if labels.lag is not None and labels.lag.correlation < 0 and not labels.plan.why.startswith("driven by"):
            correlation = f"{labels.lag.correlation:.2f} correlation"
            return Advice(f"the pictures of {session} turn the other way than its steering ({correlation})", check)
        if kind in ("none", "constant", "other scale"):
            what = {"none": "is always 0", "constant": "never changes", "other scale": "is not of -1 to 1"}[kind]
            return Advice(f"the steering of {session} {what} ({counted(labels.habits.rows, 'row')})", check)
    return None


def is_unfinished(numbers: RunNumbers) -> Advice | None:
    learnt, asked = numbers.learnt, numbers.training.epochs
    if learnt >= asked or numbers.training.patience:
        return None
    return Advice(f"stopped after {learnt:,} of {counted(asked, 'epoch')}", f"bc-train resume {numbers.run}")


def has_worse_answers(numbers: RunNumbers) -> Advice | None:
    """Natural answers are worse than answers as learnt, and the answers as learnt beat always predicting the mean.
    After few steps, more epochs help first; of a few frames, the difference may be chance; and a lap without
    intervention says more than errors."""
    kept = numbers.kept
    if (
        kept is None
        or numbers.is_short
        or numbers.drives_well
        or kept.learnt is None
        or kept.answers == AnswerScale()
        or kept.measures.frames < FEW_FRAMES
    ):
        return None
    natural, learnt = kept.measures.driving_error, kept.learnt_driving_error
    command = f"bc-train --like {numbers.run} --answers as-learnt"
    as_natural, as_learnt, mean = kept.measures.network, kept.learnt, kept.measures.mean
    is_worse = as_natural.rmse_deg > as_learnt.rmse_deg and as_natural.turning_mae_deg > as_learnt.turning_mae_deg
    if natural - learnt > WORSE_ANSWERS and not as_natural.rmse_deg < mean.rmse_deg <= as_learnt.rmse_deg:
        return Advice(
            f"natural answers make it worse: driving error {natural:.2f}, as learnt {learnt:.2f}", command
        )
    is_cure = as_learnt.rmse_deg < mean.rmse_deg <= as_natural.rmse_deg and learnt - natural <= WORSE_ANSWERS
    if is_cure or (math.isnan(learnt) and is_worse):
        shown = kept.measures.unit.of
        errors = f"RMSE {shown(as_natural.rmse_deg):.2f}, as learnt {shown(as_learnt.rmse_deg):.2f}"
        return Advice(f"natural answers make it worse: {errors}", command)
    return None


def is_enough(numbers: RunNumbers) -> Advice | None:
    """The network drives, or is likely to, and no drive of it needed an intervention."""
    driven, measured = numbers.drives, numbers.measured
    if measured is None or any(_interventions(drive) for drive in driven):
        return None
    band = numbers.drivable.band if numbers.drivable is not None else None
    turns = measured.network.turning_mae_deg < measured.mean.turning_mae_deg
    is_likely = band is not None and band.share >= 1 and turns
    if not is_likely and not (numbers.drives_well and numbers.is_built_in):
        return None
    small = f"a driving error of {measured.driving_error:.2f} is small enough to try"
    if not numbers.is_built_in:
        return Advice(small, numbers.drive_command)
    tracks = "random:1 random:2" if numbers.has_driven_a_lap else "lake mountain"
    why = small if not numbers.has_driven_a_lap else "it needed no intervention on the roads it has driven"
    return Advice(why, f"bc-eval drive {numbers.run} --tracks {tracks}")


def has_left_the_road(numbers: RunNumbers) -> Advice | None:
    """The network left the road: an expert takes over where it errs, and it learns from the takeovers
    (docs/studies/takeovers.md)."""
    failed = [drive for drive in numbers.drives if _interventions(drive)]
    if not failed or numbers.is_short:
        return None
    worst = max(failed, key=_interventions)
    track, speed = str(worst["track"]), float(worst["set_speed_mph"])
    times = counted(_interventions(worst), "intervention")
    return Advice(
        f"{times} on {printable(track)} at {speed:g} mph; an expert there shows it what to do",
        f"bc-drive {numbers.run} --simulator {shlex.quote(track)} --speed {speed:g} --takeover",
    )


def is_still_improving(numbers: RunNumbers) -> Advice | None:
    epochs = [epoch for epoch in numbers.epochs if epoch.measures.frames]
    more = f"bc-train resume {numbers.run} --epochs {max(10, 2 * numbers.learnt)}"
    if not epochs:
        return None
    errors = [epoch.measures.driving_error for epoch in epochs]
    is_best = errors[-1] == min(errors)
    if numbers.is_short:
        learnt = f"{counted(len(epochs), 'epoch')} of {numbers.epoch_samples / numbers.training.batch:,.0f} steps"
        return Advice(f"{learnt}: networks of fewer than {ENOUGH_STEPS} steps seldom drive", more)
    if not is_best or len(errors) == 1:
        return None
    before, last = errors[-2:]
    if before - last > STILL_IMPROVING * before:
        return Advice(f"its driving error still fell in epoch {len(epochs):,} ({before:.2f} to {last:.2f})", more)
    return None


def has_few_turns(numbers: RunNumbers) -> Advice | None:
    if (turns := _turns_learnt(numbers)) is None or turns >= FEW_TURNS:
        return None
    return Advice(f"about {counted(turns, 'row')} of turns to learn from; {FEW_TURNS:,} are few", _record(numbers))


def has_one_session(numbers: RunNumbers) -> Advice | None:
    if len(numbers.data.logs) != 1:
        return None
    return Advice(
        "it has learnt from one session; another road or light would help it to generalise", _record(numbers)
    )


def has_one_side(numbers: RunNumbers) -> Advice | None:
    bins = numbers.held_out_bins
    left, right = (sum(b.frames for b in bins if b.high <= 0), sum(b.frames for b in bins if b.low >= 0))
    if not left + right or min(left, right) >= FEW_OF_A_SIDE * (left + right):
        return None
    side, share = "left" if left < right else "right", min(left, right) / (left + right)
    one_sided = f"{100 * share:.0f} % of the turns held out go {side}"
    if not numbers.data.settings.flip:
        return Advice(f"{one_sided}, and nothing is mirrored", _index(numbers))
    return Advice(f"{one_sided}: drive the road the other way round, too", _record(numbers))


def has_one_camera(numbers: RunNumbers) -> Advice | None:
    """The side cameras are unused. Their pictures show how to return to the middle."""
    frames = sum(count.frames for count in numbers.data.counts.values())
    rows = sum(labels.habits.rows for labels in numbers.data.labels.values())
    has_others = not rows or frames > 1.5 * rows
    if not has_others or set(numbers.data.settings.cameras) != {"center"}:
        return None
    return Advice("the side cameras are left out", _index(numbers, "--cameras center left right"))


def nothing_stands_out(numbers: RunNumbers) -> Advice:
    if numbers.measured is None and not numbers.drives:  # no frame is held out: `bc-eval RUN` would measure none
        drive = numbers.drive_command
        if numbers.is_built_in:
            drive = f"bc-eval drive {numbers.run} --tracks lake mountain"
        return Advice("nothing of it is measured yet; a drive shows how good it is", drive)
    return Advice("nothing in its numbers stands out; recordings of other roads help most", _record(numbers))


RULES: Final[tuple[Callable[[RunNumbers], Advice | None], ...]] = (
    is_being_trained,
    has_wrong_labels,
    is_unfinished,
    has_worse_answers,
    is_enough,
    has_left_the_road,
    is_still_improving,
    has_few_turns,
    has_one_session,
    has_one_side,
    has_one_camera,
    nothing_stands_out,
)
"""Wrong labels make everything else useless. Measured causes come before likely ones. Advice that costs minutes
comes before a new recording."""


def _interventions(drive: Mapping[str, Any]) -> int:
    return int(drive["interventions"])


def _turns_learnt(numbers: RunNumbers) -> int | None:
    """Estimated rows of turns in the training data, from the share of turns among the frames held out; None if
    unknown."""
    bins = numbers.held_out_bins
    held_out = sum(part.frames for part in bins)
    frames = sum(count.frames for count in numbers.data.counts.values())
    rows = sum(labels.habits.rows for labels in numbers.data.labels.values())
    training = sum(count.training for count in numbers.data.counts.values())
    if not held_out or not frames or not rows:
        return None
    turns = sum(part.frames for part in bins if part.low >= 0 or part.high <= 0)
    return round(turns / held_out * training * min(1.0, rows / frames))


def _record(numbers: RunNumbers) -> str:
    """The command that records another session of the same kind, with a name that no session has."""
    sessions = numbers.data.logs
    name = "more" if "more" not in sessions else f"more-{len(sessions)}"
    if numbers.is_built_in:
        return f"bc-record {name} --track random:{len(sessions)}"
    return f"bc-import {'~/mycar/data' if numbers.is_donkeycar else '~/recording'} {name}"


def _index(numbers: RunNumbers, flags: str = "") -> str:
    place = f"{numbers.sessions_flag}{numbers.index_flag}"
    return f"{f'bc-index{place} {flags}'.rstrip()} && bc-train{numbers.index_flag}"
