"""The verdict on a network: its errors compared with always predicting the mean, and the advice most likely to
help.

from model import judge
print(*judge("runs/first").lines, sep="\\n")
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from common.errors import counted, decimal
from model.metrics import Measures
from model.runs.advice import FEW_FRAMES, Advice, advice
from model.runs.enough_to_drive import Drivable
from model.runs.run_numbers import A_WHOLE_LAP, RunNumbers

OF_THE_MEAN: Final = 2.0
"""The driving error of always predicting the mean."""
NO_BETTER: Final = "no better"
UNKNOWN: Final = "unknown"
_UNKNOWN: Final = Drivable(None, "")


@dataclass(frozen=True)
class ComparedError:
    """An error of a network, and the error of always predicting the mean of the same rows."""

    name: str
    network: float
    mean: float
    unit: str = ""

    @property
    def ratio(self) -> float:
        """The network's error divided by the mean's: below 1, the network is better."""
        return self.network / self.mean if self.mean else math.nan

    def __str__(self) -> str:
        return f"{self.name} ({decimal(self.network, 2)} against {self.mean:.2f}{self.unit})"


@dataclass(frozen=True)
class Verdict:
    """How good a network is, from its errors on rows held out, and what to do next."""

    beside_mean: tuple[ComparedError, ...]  # on turns, driving error, RMSE; without unknown ones
    drivable: Drivable
    advice: Advice
    driven: str = ""  # how the network drove; takes precedence over the prediction from its errors
    interventions: int | None = None  # in these drives; None without a drive, or without any in a part of a lap
    has_crashes: bool = False  # the rows may include crashes
    frames: int = FEW_FRAMES  # that were measured
    is_measurable: bool = False  # frames are held out, but no epoch has ended

    @property
    def is_no_better(self) -> bool:
        """True if one of the errors is no better than always predicting the mean."""
        return any(not error.ratio < 1 for error in self.beside_mean)

    @property
    def in_short(self) -> str:
        """The verdict in one to three words, for a table."""
        if self.is_no_better and self.interventions != 0:  # a clean drive shows more than its errors
            return NO_BETTER
        if self.interventions is not None:
            return "leaves the road" if self.interventions else "drives"
        if not self.beside_mean:
            return UNKNOWN
        return {True: "enough", False: "too weak", None: "perhaps"}[self.drivable.is_enough]

    @property
    def lines(self) -> tuple[str, str]:
        """Two lines; the second has a command."""
        return self.summary, f"next: `{self.advice.command}`: {self.advice.why}"

    @property
    def summary(self) -> str:
        if not self.beside_mean:
            nothing = "no epoch has ended" if self.is_measurable else "nothing was held out"
            why = "the measured steering never changes" if self.frames else nothing
            return f"{why}, so its error is unknown{self.driven and f'; {self.driven}'}"
        *before_rmse, rmse = self.beside_mean
        worse = [error for error in self.beside_mean if not error.ratio < 1]
        better = [error for error in self.beside_mean if error.ratio < 1]
        parts = [f"no better than always predicting the mean: {_joined(worse)}"] if worse else []
        shown = better if worse else before_rmse or [rmse]
        if shown:
            parts.append(f"better than {'it' if worse else 'always predicting the mean'}: {_joined(shown)}")
        if self.frames < FEW_FRAMES:
            parts.append(f"only {counted(self.frames, 'frame')} measured, so these errors are uncertain")
        crashes = ["crashes were held out, too: `bc-eval` measures without them"] * self.has_crashes
        return "; ".join([*parts, self.driven or self._to_drive(), *crashes])

    def _to_drive(self) -> str:
        if self.is_no_better:
            return "not enough to drive"
        if "driving error" not in [error.name for error in self.beside_mean]:
            return "its driving error is not kept: `bc-eval` measures it"
        words = {True: "enough to drive", False: "not enough to drive", None: "perhaps enough to drive"}
        return f"{words[self.drivable.is_enough]}: {self.drivable.why}"


def verdict_of(numbers: RunNumbers) -> Verdict:
    measured = numbers.measured
    errors = () if measured is None else _compared_with_mean(measured)
    is_known = any(error.name == "driving error" for error in errors)
    judged = numbers.drivable if is_known else None
    interventions = sum(int(drive["interventions"]) for drive in numbers.drives) if numbers.drives else None
    driven = ""
    if interventions is not None:
        different = len({drive.get("track") for drive in numbers.drives})
        tracks = counted(different, "track")
        if len(numbers.drives) > different:
            tracks += f" in {len(numbers.drives)} drives"
        laps = part_of_laps(numbers.drives)
        driven = f"has driven {laps and f'{laps} of '}{tracks} with {counted(interventions, 'intervention')}"
    frames = measured.frames if measured is not None else 0
    return Verdict(
        errors,
        judged or _UNKNOWN,
        advice(numbers),
        driven,
        interventions if interventions or numbers.has_driven_a_lap else None,
        numbers.has_crashes,
        frames,
        is_measurable=bool(numbers.recordings) and not numbers.epochs,
    )


def part_of_laps(drives: Sequence[Mapping[str, Any]]) -> str:
    """The laps of some drives together, "0.03 laps"; empty if each is whole, or if one is unknown."""
    laps: list[Any] = [drive.get("laps") for drive in drives]
    is_known = all(isinstance(of_one, int | float) and of_one >= 0 for of_one in laps)
    return f"{sum(laps):.2f} laps" if is_known and min(laps) < A_WHOLE_LAP else ""


def _compared_with_mean(measured: Measures) -> tuple[ComparedError, ...]:
    """The errors that are known. There may be no turns, and earlier versions stored no balanced error of the
    mean."""
    network, mean = measured.network, measured.mean
    unit = measured.unit
    name = f" {unit.name}"
    turns = (unit.of(network.turning_mae_deg), unit.of(mean.turning_mae_deg))
    pairs = [ComparedError("on turns", *turns, name)]
    if measured.mean_balanced_rmse_deg > 0:
        pairs.append(ComparedError("driving error", measured.driving_error, OF_THE_MEAN))
    pairs.append(ComparedError("RMSE", unit.of(network.rmse_deg), unit.of(mean.rmse_deg), name))
    return tuple(error for error in pairs if error.mean > 0)


def _joined(errors: list[ComparedError]) -> str:
    return ", ".join(map(str, errors))
