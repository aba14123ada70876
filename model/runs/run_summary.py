"""The summary of a run: settings, errors and drives in a few numbers, to compare with other runs."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from common.car import MAX_STEERING_DEG
from common.errors import as_user_error
from common.steering_unit import SteeringUnit, steering_unit
from model.errors import RunError
from model.metrics import Measures
from model.runs.enough_to_drive import Hand
from model.runs.history import read_epochs
from model.runs.network_of_run import stored_network, stored_targets
from model.runs.run_files import (
    CONFIG,
    WEIGHTS,
    KeptResult,
    config_folder,
    is_being_trained,
    kept_results,
    load_config,
    weights_checksum,
)
from model.runs.run_numbers import run_numbers
from model.runs.training_progress import Epoch
from model.runs.verdict import Verdict, verdict_of

_SPLIT_SETTINGS: Final = (
    "validation", "validation_share", "seed", "block_s", "gap_s", "cameras", "drives", "where", "flip",
)  # fmt: skip


@dataclass(frozen=True)
class RunSummary:
    """A run in short. Errors are those of the kept epoch on the frames held out, in degrees (by `assumed_deg`);
    NaN if nothing was held out."""

    name: str
    folder: str
    written_at: str = ""  # UTC, ISO 8601: time of the weights or, before the first ones, of the config
    problem: str = ""  # why the run cannot be read
    network: str = ""
    targets: list[str] = field(default_factory=list)  # that the network answers, steering first
    recipe: str = ""
    seed: int = 0
    sessions: list[str] = field(default_factory=list)
    epochs: int = 0  # learnt
    epochs_asked: int = 0
    kept_epoch: int = 0
    rmse_deg: float = math.nan
    mean_rmse_deg: float = math.nan  # of always predicting the mean
    balanced_rmse_deg: float = math.nan
    mean_balanced_rmse_deg: float = math.nan
    correlation: float = math.nan
    max_deg: float | None = MAX_STEERING_DEG  # the wheels' angle at steering 1; None: unknown
    split: str = ""  # identifies the frames held out; runs with the same split were measured on the same frames
    results: list[KeptResult] = field(default_factory=list)  # of these weights, the last of each kind
    verdict: Verdict | None = None

    @property
    def rmse_share(self) -> float:
        """The RMSE divided by the RMSE of always predicting the mean, because runs hold out different frames."""
        return _share(self.rmse_deg, self.mean_rmse_deg)

    @property
    def balanced_rmse_share(self) -> float:
        return _share(self.balanced_rmse_deg, self.mean_balanced_rmse_deg)

    @property
    def epochs_in_short(self) -> str:
        """The kept epoch of those learnt; before the first one, how many were asked for."""
        return f"{self.kept_epoch or '-'}/{self.epochs}" if self.epochs else f"0 of {self.epochs_asked}"

    @property
    def unit(self) -> SteeringUnit:
        return steering_unit(self.max_deg)

    @property
    def drives(self) -> list[dict[str, Any]]:
        """The last drive of each simulated track at each speed, as `bc-eval --json` prints it."""
        return [kept.result for kept in self.results if kept.way == "simulator"]

    @property
    def supervised(self) -> list[dict[str, Any]]:
        """The last supervised drive of each track at each speed."""
        return [kept.result for kept in self.results if kept.way == "supervised"]

    @property
    def interventions_per_km(self) -> float:
        """Over all `drives`; if there are none, over the supervised drives; NaN if the run has not driven."""
        drives = self.drives or self.supervised
        driven_m = sum(drive["distance_m"] for drive in drives)
        return 1000 * sum(drive["interventions"] for drive in drives) / driven_m if driven_m else math.nan


def _share(value: float, whole: float) -> float:
    return value / whole if whole else math.nan


def summarize_runs(runs: Path) -> Iterator[RunSummary]:
    """Summaries of all runs in a folder, by name; a run that cannot be read has only its problem."""
    for config in sorted(runs.glob(f"*/{CONFIG}")):
        yield summarize_run(config.parent)


def judge(
    run: Path | str,
    measured: Measures | None = None,
    sessions: Sequence[str] = (),
    hands: Mapping[str, Hand] = MappingProxyType({}),
) -> Verdict:
    """The verdict on a run, from the numbers in its folder, or from the errors `measured` on rows of `sessions`.
    `hands` says how sessions that are not in the run's index were steered. Raises RunError if the run cannot be
    read."""
    run = config_folder(Path(run))
    try:
        config = load_config(run)
        numbers = run_numbers(run, config, read_epochs(run), last_results(run), is_training=is_being_trained(run))
    except (OSError, ValueError) as error:
        raise RunError(f"{run}: cannot be judged ({' '.join(str(error).split())})") from None
    return verdict_of(numbers if measured is None else numbers.of_rows(measured, sessions, hands))


def summarize_run(run: Path) -> RunSummary:
    """The summary of a run; a run that cannot be read has only its problem."""
    try:
        return _summary(run)
    except Exception as error:
        return RunSummary(run.name, str(run), problem=" ".join(str(as_user_error(run, error)).split()))


def _summary(run: Path) -> RunSummary:
    has_weights = (run / WEIGHTS).exists()
    written_s = (run / (WEIGHTS if has_weights else CONFIG)).stat().st_mtime
    stored = load_config(run)
    epochs = read_epochs(run)
    results = last_results(run) if has_weights else []
    numbers = run_numbers(run, stored, epochs, results, is_training=is_being_trained(run))
    kept = numbers.kept
    return RunSummary(
        run.name,
        str(run),
        datetime.fromtimestamp(written_s, UTC).isoformat(timespec="seconds"),
        network=stored_network(stored, run).name,
        targets=list(stored_targets(stored, run)),
        recipe=numbers.training.recipe,
        seed=numbers.training.seed,
        sessions=list(numbers.data.logs),
        epochs=epochs[-1].epoch if epochs else 0,
        epochs_asked=numbers.training.epochs,
        **_errors(kept),
        split=_split(stored["data"], kept) if kept and kept.measures.frames and numbers.data.logs else "",
        results=results,
        verdict=verdict_of(numbers),
    )


def _split(data: Mapping[str, Any], kept: Epoch) -> str:
    """A short name of the frames held out: a hash of the logs, the settings of the split and the number of
    frames."""
    settings = data.get("settings", {})
    logs = {name: log.get("fingerprint") for name, log in data["logs"].items()}
    described = [logs, {name: settings.get(name) for name in _SPLIT_SETTINGS}, kept.measures.frames]
    return hashlib.sha256(json.dumps(described, sort_keys=True, default=str).encode()).hexdigest()[:8]


def _errors(kept: Epoch | None) -> dict[str, Any]:
    if kept is None:
        return {}
    measures = kept.measures
    return {
        "kept_epoch": kept.epoch,
        "rmse_deg": measures.network.rmse_deg,
        "mean_rmse_deg": measures.mean.rmse_deg,
        "balanced_rmse_deg": measures.balanced_rmse_deg if measures.frames else math.nan,
        "mean_balanced_rmse_deg": measures.mean_balanced_rmse_deg,
        "correlation": measures.network.correlation,
        "max_deg": measures.max_deg,
    }


def last_results(run: Path) -> list[KeptResult]:
    """The last results of the run's present weights: one for each track and speed, for each driven recording, and
    for each choice of recorded frames."""
    results, _ = kept_results(run)
    checksum = weights_checksum(run) if results else ""
    last: dict[tuple[object, ...], KeptResult] = {}
    for kept in results:
        result = kept.result
        if kept.weights_sha256 == checksum and _is_whole(kept):
            names = ("track", "set_speed_mph", "session", "departure_m", "index", "split")
            # results of whole sessions have no index: the sessions' names distinguish them
            last[kept.way, *(str(result.get(name)) for name in names), *measured_sessions(result)] = kept
    return list(last.values())


def measured_sessions(result: Mapping[str, Any]) -> list[str]:
    """The measured sessions, if they were named (`bc-eval --session`); else empty."""
    sessions = result.get("sessions")
    return sorted(sessions) if result.get("index") is None and isinstance(sessions, dict) else []


def _is_whole(kept: KeptResult) -> bool:
    """True if a drive has the numbers that sums over drives need. True for other results."""
    if kept.way not in ("simulator", "supervised"):
        return True
    names = ("distance_m", "interventions", "set_speed_mph", *(("by_person",) if kept.way == "supervised" else ()))
    numbers = [kept.result.get(name) for name in names]
    are_valid = all(isinstance(number, int | float) and 0 <= number < 1e12 for number in numbers)
    return are_valid and isinstance(kept.result.get("track"), str)
