"""The verdict on a network: how it compares with knowing nothing, and the one thing most likely to help.

from model import judge
print(*judge("runs/first").lines, sep="\\n")
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from common.errors import counted, decimal
from model.metrics import Measures
from model.runs.advice import Advice, advice
from model.runs.enough_to_drive import Drivable, drivable
from model.runs.run_numbers import RunNumbers

OF_THE_MEAN: Final = 2.0
"""The driving error of always predicting the mean."""
FEW_FRAMES: Final = 300
"""Half a minute at ten frames a second: six stretches of 5 s, within which errors are alike. Of fewer, an interval
is a guess (`model.evaluation.differences`)."""
_UNKNOWN: Final = Drivable(None, "")


@dataclass(frozen=True)
class BesideTheMean:
    """An error of a network, compared with that of always predicting the mean of the same rows."""

    name: str
    network: float
    mean: float
    unit: str = ""

    @property
    def ratio(self) -> float:
        """Below 1, the network is better."""
        return self.network / self.mean if self.mean else math.nan

    def __str__(self) -> str:
        return f"{self.name} ({decimal(self.network, 2)} against {self.mean:.2f}{self.unit})"


@dataclass(frozen=True)
class Verdict:
    """How good a network is, by its errors on rows that it has not learnt, and what to do next."""

    beside_mean: tuple[BesideTheMean, ...]  # on turns, driving error, RMSE: those that are known
    drivable: Drivable
    advice: Advice
    driven: str = ""  # how it has driven, where it has: that goes before what its errors foretell
    interventions: int | None = None  # in these drives
    has_crashes: bool = False  # among these rows, perhaps
    frames: int = FEW_FRAMES  # that were measured

    @property
    def is_no_better(self) -> bool:
        """Whether always predicting the mean is as good in any of them."""
        return any(not error.ratio < 1 for error in self.beside_mean)

    @property
    def in_short(self) -> str:
        """In a word or two, for a table."""
        if not self.beside_mean:
            return "-"
        if self.is_no_better:
            return "no better"
        if self.interventions is not None:
            return "leaves the road" if self.interventions else "drives"
        return {True: "enough", False: "too weak", None: "perhaps"}[self.drivable.is_enough]

    @property
    def lines(self) -> tuple[str, str]:
        """Two lines; the second has a command."""
        return self.summary, f"next: `{self.advice.command}`: {self.advice.why}"

    @property
    def summary(self) -> str:
        if not self.beside_mean:
            return f"nothing was held out, so how good it is is unknown{self.driven and f'; {self.driven}'}"
        *words, rmse = self.beside_mean
        worse, better = (
            [error for error in self.beside_mean if (error.ratio < 1) == is_so] for is_so in (False, True)
        )
        parts = [f"no better than always predicting the mean: {_joined(worse)}"] if worse else []
        shown = better if worse else words or [rmse]
        if shown:
            parts.append(f"better than {'it' if worse else 'always predicting the mean'}: {_joined(shown)}")
        if self.frames < FEW_FRAMES:
            parts.append(f"only {counted(self.frames, 'frame')} measured, so these errors are unsure")
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
    """The verdict on a run, by its numbers."""
    measured = numbers.measured
    errors = () if measured is None else _beside_the_mean(measured)
    is_known = any(error.name == "driving error" for error in errors)
    judged = (
        drivable(measured.driving_error, numbers.hands, is_unseen=numbers.is_unseen)
        if measured is not None and is_known
        else _UNKNOWN
    )
    interventions = sum(int(drive["interventions"]) for drive in numbers.drives) if numbers.drives else None
    driven = ""
    if interventions is not None:
        tracks = counted(len(numbers.drives), "track")
        driven = f"has driven {tracks} with {counted(interventions, 'intervention')}"
    frames = measured.frames if measured is not None else 0
    return Verdict(errors, judged, advice(numbers), driven, interventions, numbers.has_crashes, frames)


def _beside_the_mean(measured: Measures) -> tuple[BesideTheMean, ...]:
    """Those that are known: there may be no turns, and earlier versions kept no balanced error of the mean."""
    network, mean = measured.network, measured.mean
    unit = measured.unit
    name = f" {unit.name}"
    turns = (unit.of(network.turning_mae_deg), unit.of(mean.turning_mae_deg))
    pairs = [BesideTheMean("on turns", *turns, name)]
    if measured.mean_balanced_rmse_deg > 0:
        pairs.append(BesideTheMean("driving error", measured.driving_error, OF_THE_MEAN))
    pairs.append(BesideTheMean("RMSE", unit.of(network.rmse_deg), unit.of(mean.rmse_deg), name))
    return tuple(error for error in pairs if error.mean > 0)


def _joined(errors: list[BesideTheMean]) -> str:
    return ", ".join(map(str, errors))
