"""A sweep: many trainings, each driven when it is trained; finished ones are not repeated.

A training that was stopped or killed goes on from its checkpoint. Finished ones are known from the runs
themselves: their checkpoints and kept results. Where runs are kept in a store, each is made here and copied there,
so that no machine repeats the work of another.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from common.errors import UserError
from common.location import Location, Url
from common.tasks import Tasks
from drive.config import DriveConfig
from drive.evaluation.closed_loop import LogFolder, PlannedDrive, evaluate
from drive.evaluation.simulator_process import BuiltInSimulator
from drive.evaluation.sweep_plan import SweepPlan, Training
from model import load_pilot, train
from model.network.names import is_own
from model.network.own_code import load_code
from model.runs.kept_results import keep_result
from model.runs.run_arguments import RUNS
from model.runs.run_files import CONFIG
from model.runs.run_summary import RunSummary, summarize_run
from model.runs.runs_in_store import bring_summary, run_at
from model.runs.stored_run import RunCopy, copy_of_run

_MAX_OVERSHOOT_LAPS: Final = 0.05
"""A drive ends with the first telemetry after its laps."""


@dataclass(frozen=True)
class Swept:
    training: Training
    summary: RunSummary | None  # as far as it came; None where there is no run
    failure: str = ""  # why it did not come to its end
    problems: tuple[str, ...] = ()  # files that could not be copied to the store


def run_sweep(sweep: SweepPlan, index: Location, runs: Location, logs: Location, tasks: Tasks) -> Iterator[Swept]:
    """Run the trainings and drives that are not finished; yields results as they come. `logs` is the folder of the
    drives' logs.

    A training or drive that fails is a result, too, and the others go on.
    """
    calls = [(training, sweep.drives, index, runs, LogFolder.of(logs)) for training in sweep.trainings]

    def lost(number: int, why: str) -> Swept:
        training = sweep.trainings[number]
        return _failed(training, _run_here(runs, training), why)

    for _, swept in tasks(_train_and_drive, calls, lost):
        yield swept


def _train_and_drive(
    training: Training,
    drives: Sequence[PlannedDrive],
    index: Location,
    runs: Location,
    logs: LogFolder,
) -> Swept:
    run = _run_here(runs, training)
    copy: RunCopy | None = None
    problems: list[str] = []
    failure = ""
    try:
        if isinstance(runs, Url):
            done = _done_elsewhere(runs / training.run, training, drives)
            if done is not None:
                return Swept(training, done)
            copy = copy_of_run(runs / training.run, run)
        problems = _train_and_drive_here(training, drives, index, run, logs, copy)
    except (UserError, OSError, MemoryError, RuntimeError) as error:  # RuntimeError: PyTorch's, also of memory
        failure = " ".join(str(error).split())
    finally:  # also of what Ctrl-C has stopped
        problems += [] if copy is None else filter(None, [copy.finish()])
    swept = _failed(training, run, failure) if failure else Swept(training, summarize_run(run))
    return replace(swept, problems=tuple(problems))


def _train_and_drive_here(
    training: Training,
    drives: Sequence[PlannedDrive],
    index: Location,
    run: Path,
    logs: LogFolder,
    copy: RunCopy | None,
) -> list[str]:
    """Give why logs of drives are not in the store where they belong."""
    if is_own(training.config.network):
        load_code(training.config.network)
    train(index, run, training.config, [] if copy is None else [copy], resume=(run / CONFIG).exists())
    summary = summarize_run(run)
    missing = [drive for drive in drives if not _is_driven(summary, *drive)]
    if not missing:
        return []
    if copy is not None:
        copy.finish()  # before the minutes that drives take
    pilot = load_pilot(run, device=training.config.device)
    pilot.warm_up()
    problems = []
    # a log without its result is that of a drive that was killed before it could be kept
    for result in evaluate(pilot, missing, logs, overwrite=True):
        keep_result(run, "simulator", result.as_dict())
        problems += [result.problem] if result.problem else []
    return problems


def _run_here(runs: Location, training: Training) -> Path:
    return (RUNS if isinstance(runs, Url) else runs) / training.run


def _done_elsewhere(url: Url, training: Training, drives: Sequence[PlannedDrive]) -> RunSummary | None:
    """The summary of a run in a store that has learnt all its epochs and was driven then: nothing else of it has
    to be fetched. None for all others."""
    run = run_at(url)
    if run is None or not run.has_weights or not drives:
        return None
    summary = summarize_run(bring_summary(run))
    is_trained = not summary.problem and summary.epochs >= training.config.epochs
    is_done = is_trained and all(_is_driven(summary, *drive) for drive in drives)
    return replace(summary, folder=str(url)) if is_done else None


def _failed(training: Training, run: Path, why: str) -> Swept:
    return Swept(training, summarize_run(run) if (run / CONFIG).exists() else None, why)


def _is_driven(summary: RunSummary, simulator: BuiltInSimulator, config: DriveConfig) -> bool:
    return any(
        (kept.get("track"), kept["set_speed_mph"]) == (simulator.track, config.set_speed_mph)
        and (
            kept.get("gave_up")
            or simulator.laps <= (kept.get("laps") or 0.0) < simulator.laps + _MAX_OVERSHOOT_LAPS
        )
        for kept in summary.drives
    )
