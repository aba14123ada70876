"""The numbers of a run, from its files, for the verdict on it. They are not trusted."""

from __future__ import annotations

import math
import os
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Annotated, Any, Final, TypeVar

import msgspec

from common.car import BUILT_IN_WHEELBASE_M, MAX_STEERING_DEG
from common.errors import printable
from model.config import enough_passes
from model.metrics import BinErrors, Measures
from model.runs.enough_to_drive import Drivable, Hand, drivable
from model.runs.history import parse_measures
from model.runs.network_of_run import own_network_flag
from model.runs.run_files import RUNS, KeptResult, run_argument
from model.runs.training_progress import Epoch

_BUILT_IN_CAR: Final = {"max_steering_deg": MAX_STEERING_DEG, "wheelbase_m": BUILT_IN_WHEELBASE_M}


class StoredHabits(msgspec.Struct):
    """How a session was steered: the part of `recorder.rows.steering_habits` that the verdict needs."""

    kind: str = ""
    rows: int = 0
    device: str = ""


class StoredLag(msgspec.Struct):
    correlation: float = math.nan


class StoredPlan(msgspec.Struct):
    smooth_s: float = 0.0
    without_crashes: bool = False
    why: str = ""


class StoredLabels(msgspec.Struct):
    habits: StoredHabits = msgspec.field(default_factory=StoredHabits)
    lag: StoredLag | None = None
    plan: StoredPlan = msgspec.field(default_factory=StoredPlan)

    @property
    def hand(self) -> Hand | None:
        """How the session was steered; None if unknown."""
        if self.habits.kind == "steps" or self.plan.smooth_s > 0:
            return "keys"
        return "smooth" if self.habits.kind == "smooth" else None


class StoredCounts(msgspec.Struct):
    frames: int = 0
    training: int = 0
    validation: int = 0
    crashed: int = 0
    not_measured: int | None = None


A_WHOLE_LAP: Final = 0.99
"""A drive may end one message before the line."""


class StoredSettings(msgspec.Struct):
    flip: bool = True
    cameras: tuple[str, ...] = ("center", "left", "right")


class StoredIndex(msgspec.Struct):
    """The index that a run was trained on, as its config.json stores it."""

    logs: dict[str, dict[str, Any]] = {}
    labels: dict[str, StoredLabels] = {}
    counts: dict[str, StoredCounts] = {}
    settings: StoredSettings = msgspec.field(default_factory=StoredSettings)


class StoredTraining(msgspec.Struct):
    epochs: int = 0
    batch: Annotated[int, msgspec.Meta(ge=1)] = 256
    recipe: str = "original"
    seed: int = 0
    patience: int = 0


@dataclass(frozen=True)
class RunNumbers:
    """A run in numbers. The verdict judges the errors `measured`, by default those of the kept epoch."""

    run: str  # as an argument of a command, with the flag that names a user's own network
    measured: Measures | None
    epochs: tuple[Epoch, ...] = ()
    training: StoredTraining = field(default_factory=StoredTraining)
    data: StoredIndex = field(default_factory=StoredIndex)
    hands: frozenset[Hand] = frozenset()  # of the measured rows; empty if one is unknown
    is_unseen: bool = False  # the run learnt nothing from the drives of the measured rows
    recordings: int = 0  # with measured rows
    drives: tuple[Mapping[str, Any], ...] = ()  # the last drive of each track and speed
    index: str = "index"  # path, from the current folder
    runs: Path = RUNS
    is_training: bool = False
    has_crashes: bool = False  # measured rows include crashes, because an earlier version's index held them out

    @property
    def learnt(self) -> int:
        """The last epoch. `epochs` may lack some before it: a long history is thinned, a line may be broken."""
        return self.epochs[-1].epoch if self.epochs else 0

    @property
    def epoch_samples(self) -> float:
        """The samples of the last epoch; NaN if they are unknown."""
        return self.epochs[-1].seconds * self.epochs[-1].samples_per_s if self.epochs else math.nan

    @property
    def is_short(self) -> bool:
        """Too few steps to drive, although more passes would help."""
        samples = self.epoch_samples
        return math.isfinite(samples) and self.learnt < enough_passes(round(samples), self.training.batch)

    @property
    def kept(self) -> Epoch | None:
        return next((epoch for epoch in reversed(self.epochs) if epoch.is_best), None)

    @property
    def drivable(self) -> Drivable | None:
        """Whether the errors `measured` are small enough to drive; None without errors."""
        if self.measured is None:
            return None
        error, hands = self.measured.driving_error, self.hands
        return drivable(error, hands, is_unseen=self.is_unseen, recordings=self.recordings)

    @property
    def held_out_bins(self) -> tuple[BinErrors, ...]:
        """The steering bins of the run's own frames held out, which are like those that it learns. Other sessions
        may have other bends."""
        measured = self.measured if not self.is_unseen or self.kept is None else self.kept.measures
        return measured.bins if measured is not None else ()

    @property
    def has_driven_a_lap(self) -> bool:
        """True if the drives make a lap or more together, or if one did not count laps."""
        laps = [drive.get("laps") for drive in self.drives]
        numbers = [of_one for of_one in laps if isinstance(of_one, int | float)]
        return bool(laps) and (len(numbers) < len(laps) or sum(numbers) >= A_WHOLE_LAP)

    @property
    def drives_well(self) -> bool:
        """True if it has driven a lap or more, and no drive needed an intervention."""
        return self.has_driven_a_lap and not any(drive["interventions"] for drive in self.drives)

    @property
    def is_built_in(self) -> bool:
        """True if all sessions of the run are of the built-in simulator, on whose roads more can be recorded."""
        cars = [log.get("car") for log in self.data.logs.values()]
        return bool(cars) and all(isinstance(car, dict) and _BUILT_IN_CAR.items() <= car.items() for car in cars)

    @property
    def is_donkeycar(self) -> bool:
        """True if all sessions of the run are tubs: no simulator has their road."""
        return bool(self.data.logs) and all(log.get("source") == "donkeycar" for log in self.data.logs.values())

    @property
    def drive_command(self) -> str:
        if self.is_donkeycar:
            return f"bc-train export {self.run} --donkeycar car"
        return f"bc-drive {self.run}"

    def log_of(self, session: str) -> str:
        """The path of a session's log from the current folder, quoted."""
        stored = self.data.logs.get(session, {}).get("log")
        place = str(stored) if isinstance(stored, str) and stored else f"../sessions/{session}.mcap"
        if "://" not in place:
            place = os.path.normpath(Path(self.index) / place)
        return shlex.quote(printable(place))

    @property
    def index_flag(self) -> str:
        return "" if self.index == "index" else f" --index {shlex.quote(self.index)}"

    @property
    def sessions_flag(self) -> str:
        """The flag with which `bc-index` finds the run's logs; empty for sessions/, or for several folders."""
        folders = {str(PurePosixPath(shlex.split(self.log_of(name))[0]).parent) for name in self.data.logs}
        folder = folders.pop() if len(folders) == 1 else "sessions"
        return "" if folder == "sessions" else f" --sessions {shlex.quote(folder)}"

    def of_rows(
        self, measured: Measures | None, sessions: Sequence[str], known: Mapping[str, Hand] = MappingProxyType({})
    ) -> RunNumbers:
        """A copy with the errors `measured` on rows of these sessions. `known` says how sessions that are not in
        the run's index were steered."""
        hands = [self.data.labels.get(name, StoredLabels()).hand or known.get(name) for name in sessions]
        all_hands = frozenset(hand for hand in hands if hand) if all(hands) else frozenset()
        counts = [self.data.counts.get(name, StoredCounts()) for name in sessions]
        is_unseen = bool(counts) and not any(count.training for count in counts)
        return replace(
            self,
            measured=measured,
            hands=all_hands,
            is_unseen=is_unseen,
            recordings=len(sessions),
            has_crashes=False,
        )


def run_numbers(
    run: Path,
    config: Mapping[str, Any],
    epochs: Sequence[Epoch],
    results: Sequence[KeptResult] = (),
    *,
    is_training: bool = False,
) -> RunNumbers:
    """The numbers of the run in `run`, from its config.json, its epochs and the last results of its weights.
    Settings that are missing from the config, or invalid, get their defaults."""
    training, data = _part(config, "training", StoredTraining), index_of_config(config)
    index = stored if isinstance(stored := config.get("index"), str) else ""
    if index and "://" not in index:
        index = os.path.normpath(run / index)
    kept = next((epoch for epoch in reversed(epochs) if epoch.is_best and epoch.measures.frames), None)
    numbers = RunNumbers(
        f"{run_argument(run)}{own_network_flag(config, run)}",
        None if kept is None else kept.measures,
        tuple(epochs),
        training,
        data,
        drives=tuple(kept.result for kept in results if kept.way == "simulator"),
        index=index or "index",
        runs=run.parent,
        is_training=is_training,
    )
    measured, evaluated = numbers.measured, None
    has_crashes = _held_out_crashes(data)
    # earlier versions did not store the balanced error of the mean
    if measured is None or math.isnan(measured.mean_balanced_rmse_deg) or has_crashes:
        evaluated = _evaluated(results)
    held_out = [name for name, count in data.counts.items() if count.validation]
    return replace(numbers.of_rows(evaluated or measured, held_out), has_crashes=has_crashes and evaluated is None)


def index_of_config(config: Mapping[str, Any]) -> StoredIndex:
    """The index in a run's config.json; an empty one if it is missing or invalid."""
    return _part(config, "data", StoredIndex)


def _held_out_crashes(data: StoredIndex) -> bool:
    """True if an earlier version built the index: it left crashes out of the training, but not of the frames held
    out."""
    return any(
        count.crashed and count.not_measured is None and data.labels.get(name, StoredLabels()).plan.without_crashes
        for name, count in data.counts.items()
    )


_Part = TypeVar("_Part", StoredTraining, StoredIndex)


def _part(config: Mapping[str, Any], name: str, kind: type[_Part]) -> _Part:
    try:
        return msgspec.convert(config.get(name, {}), kind)
    except ValueError:  # msgspec's errors are ValueErrors
        return kind()


def _evaluated(results: Sequence[KeptResult]) -> Measures | None:
    """The last errors that `bc-eval` measured on the frames held out, without crashes; None without a result."""
    for kept in reversed(results):
        if kept.way == "frames" and kept.result.get("split") == "validation":
            try:
                driving = kept.result.get("without_crashes") or {}
                return parse_measures({**kept.result, **driving}, "network")
            except (ValueError, KeyError, TypeError, RecursionError):
                continue
    return None
