"""How long a training would take, by the speed of earlier ones in this project."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

_MEASURED: Final = {"original": 270.0, "pilotnet": 1138.0, "small": 4798.0, "resnet18": 71.0}
"""Samples learned a second on one thread (docs/studies/networks.md): on a processor, their ratios hold roughly."""


@dataclass(frozen=True)
class EarlierTraining:
    """What is known of a run that was trained here."""

    run: str
    network: str
    device: str  # "cpu", "cuda"; "" if unknown
    samples_per_s: float


@dataclass(frozen=True)
class TrainingCost:
    """Seconds of a training with each network whose time is known, by an earlier run."""

    seconds: Mapping[str, float]
    by: EarlierTraining

    def words(self, network: str) -> str:
        """One line: the chosen network's time, then the others'."""
        others = ", ".join(f"{name} {time_words(time)}" for name, time in self.seconds.items() if name != network)
        own = self.seconds.get(network)
        head = f"about {time_words(own)} for {network}" if own is not None else "time not known"
        return f"{head}{f' ({others})' if others else ''}, by the speed of {self.by.run} on {self.by.device}"


def training_cost(
    samples: int, epochs: int, network: str, device: str, earlier: Sequence[EarlierTraining]
) -> TrainingCost | None:
    """What `epochs` over so many samples cost. `earlier`: the newest run first; `device`: "auto" for any. None
    where no run tells it."""
    fit = [
        run
        for run in earlier
        if math.isfinite(run.samples_per_s) and run.samples_per_s > 0 and device in ("auto", run.device)
    ]
    by = next((run for run in fit if run.network == network), None) or next(iter(fit), None)
    if by is None:
        return None
    work = samples * epochs
    seconds: dict[str, float] = {}
    for name in dict.fromkeys([*_MEASURED, network]):
        same = next((run for run in fit if run.network == name and run.device == by.device), None)
        if same is not None:
            seconds[name] = work / same.samples_per_s
        elif by.device == "cpu" and by.network in _MEASURED and name in _MEASURED:
            seconds[name] = work / by.samples_per_s * _MEASURED[by.network] / _MEASURED[name]
    return TrainingCost(seconds, by)


def time_words(seconds: float) -> str:
    """A time in two figures: "40 s", "12 min", "3.5 h"."""
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    if seconds < 5400:
        return f"{round(seconds / 60)} min"
    return f"{seconds / 3600:.1f} h" if seconds < 36_000 else f"{seconds / 3600:,.0f} h"
