"""A sweep: many trainings, each driven when it is trained; what is done already is not done again.

A training that was stopped or killed goes on from its checkpoint. What is done is known from the runs themselves:
their checkpoints and kept results.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from common.errors import UserError
from common.tasks import Tasks
from drive.config import DriveConfig
from drive.evaluation.closed_loop import evaluate
from drive.evaluation.simulator_process import BuiltInSimulator
from drive.evaluation.sweep_plan import SweepPlan, Training
from model import load_pilot, train
from model.network.names import is_own
from model.network.own_code import load_code
from model.runs.kept_results import keep_result
from model.runs.run_folder import CONFIG
from model.runs.run_summary import RunSummary, summarize_run

_MOST_OVERSHOOT_LAPS: Final = 0.05
"""A drive ends with the first telemetry after its laps."""


@dataclass(frozen=True)
class Swept:
    """What became of one training of a sweep."""

    training: Training
    summary: RunSummary | None  # as far as it came; None where there is no run
    failure: str = ""  # why it did not come to its end


def run_sweep(sweep: SweepPlan, index: Path, runs: Path, logs: Path, tasks: Tasks) -> Iterator[Swept]:
    """Train and drive what is not yet; the results as they come. `logs` is the folder of the drives' logs.

    A training or drive that fails is a result, too, and the others go on.
    """
    calls = [(training, sweep.drives, index, runs / training.run, logs) for training in sweep.trainings]

    def lost(number: int, why: str) -> Swept:
        training = sweep.trainings[number]
        return _failed(training, runs / training.run, why)

    for _, swept in tasks(_train_and_drive, calls, lost):
        yield swept


def _train_and_drive(
    training: Training,
    drives: Sequence[tuple[BuiltInSimulator, DriveConfig]],
    index: Path,
    run: Path,
    logs: Path,
) -> Swept:
    try:
        if is_own(training.config.network):
            load_code(training.config.network)
        train(index, run, training.config, resume=(run / CONFIG).exists())
        summary = summarize_run(run)
        missing = [drive for drive in drives if not _is_driven(summary, *drive)]
        if missing:
            pilot = load_pilot(run)
            pilot.warm_up()
            # a log without its result is that of a drive that was killed before it could be kept
            for result in evaluate(pilot, missing, logs, overwrite=True):
                keep_result(run, "simulator", result.as_dict())
    except (UserError, OSError, MemoryError, RuntimeError) as error:  # RuntimeError: PyTorch's, also of memory
        return _failed(training, run, " ".join(str(error).split()))
    return Swept(training, summarize_run(run))


def _failed(training: Training, run: Path, why: str) -> Swept:
    return Swept(training, summarize_run(run) if (run / CONFIG).exists() else None, why)


def _is_driven(summary: RunSummary, simulator: BuiltInSimulator, config: DriveConfig) -> bool:
    return any(
        (kept.get("track"), kept["set_speed_mph"]) == (simulator.track, config.set_speed_mph)
        and (kept.get("gave_up") or simulator.laps <= kept.get("laps", 0) < simulator.laps + _MOST_OVERSHOOT_LAPS)
        for kept in summary.drives
    )
