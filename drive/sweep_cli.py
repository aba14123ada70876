"""`bc-sweep`: many trainings, each driven; on this machine one by one, or on a Ray cluster."""

from __future__ import annotations

import json
import math
import shlex
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.markup import escape
from rich.table import Table

from common.command import DONE, DONE_BUT_SKIPPED, FAILED, run_command, warn
from common.errors import UsageError, counted, printable
from common.location_flag import LocationFlag
from common.output import plain_table, print_message, print_next, print_result, print_table
from common.progress import track
from common.random_access import is_there
from common.ray_flag import RayAddress, tasks_of
from common.steering_unit import DEGREES
from model.runs.run_files import without_nan

if TYPE_CHECKING:
    from drive.evaluation.sweep import Swept
    from model.runs.run_summary import RunSummary


@dataclass(frozen=True)
class Sweep:
    """Train with many settings and seeds, and let each network drive.

    Runs are runs/FILE-SETTINGS-seedN. The same command continues after Ctrl-C, a kill or a failure. FILE.toml
    names the settings (docs/scale.md), such as

    seeds = [0, 1, 2]
    train = { epochs = 5 }
    grid = { rate = [1e-4, 3e-4], network = ["original", "pilotnet"] }
    drive = { simulator = ["lake"], speed = [10], laps = 1 }

    bc-sweep rates.toml
    bc-sweep rates.toml --ray --cpus 4
    """

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE.toml")]
    """The plan: varied settings, seeds, drives."""
    index: LocationFlag = Path("index")
    """The index."""
    runs: LocationFlag = Path("runs")
    """Folder of the runs; copied to a URL, which machines may share."""
    drives: LocationFlag = Path("drives")
    """Folder of the drives' logs; finished logs are copied to a URL."""
    ray: RayAddress = None
    """Train and drive on a Ray cluster with shared folders."""
    cpus: float = 1.0
    """Processors for each task of --ray."""
    gpus: float = 0.0
    """GPUs for each task of --ray."""
    json: bool = False
    """Print one JSON object a training."""


def sweep(config: Sweep) -> int:
    if config.ray is None and (config.cpus, config.gpus) != (Sweep.cpus, Sweep.gpus):
        raise UsageError("--cpus, --gpus: only with --ray: without it, each training has this machine")
    if not (0 < config.cpus < math.inf and 0 <= config.gpus < math.inf):
        raise UsageError("--cpus: a number above 0 was expected; --gpus: 0 or more")

    from dataset.missing_index import missing_index
    from dataset.samples.samples_format import SAMPLES_NAME
    from drive.evaluation.sweep import run_sweep
    from drive.evaluation.sweep_plan import read_sweep

    plan = read_sweep(config.file)
    if not is_there(config.index / SAMPLES_NAME):
        raise missing_index(config.index)
    print_message(
        f"bc-sweep: {counted(len(plan.trainings), 'training')}, each with {counted(len(plan.drives), 'drive')}"
    )
    done: list[Swept] = []
    try:
        with tasks_of(config.ray, num_cpus=config.cpus, num_gpus=config.gpus) as tasks:
            trainings = run_sweep(plan, config.index, config.runs, config.drives, tasks)
            # one by one, each training has a bar of its own
            shown = trainings if config.ray is None else track(trainings, "training", len(plan.trainings))
            for swept in shown:
                done.append(swept)
                _print_one(swept, as_json=config.json)
    except KeyboardInterrupt:
        print_message("bc-sweep: finished trainings and drives are kept; the same command continues")
        raise
    finally:
        if done and not config.json:
            print_table(_table(plan.name, done))
            flag = "" if config.runs == Sweep.runs else f" --runs {shlex.quote(str(config.runs))}"
            print_next(f"bc-runs --sort interventions{flag}")
    failed = [swept for swept in done if swept.failure]
    if failed:
        warn(f"{counted(len(failed), 'training')} of {len(done):,} failed; the same command tries them again")
    if failed:
        return FAILED if len(failed) == len(done) else DONE_BUT_SKIPPED
    return DONE_BUT_SKIPPED if any(swept.problems for swept in done) else DONE


def _print_one(swept: Swept, *, as_json: bool) -> None:
    run = swept.training.run
    for problem in (*([f"{run}: {swept.failure}"] if swept.failure else []), *swept.problems):
        warn(problem)
    if as_json:
        summary = None if swept.summary is None else {**asdict(swept.summary), "results": swept.summary.drives}
        settings = asdict(swept.training.config)
        entry = {"run": run, "settings": settings, "failure": swept.failure, "summary": summary}
        print_result(json.dumps(without_nan(entry)))
    elif not swept.failure and swept.summary is not None:
        drives = swept.summary.drives
        driven = f", autonomy {_mean(swept.summary):.1f} % in {counted(len(drives), 'drive')}" if drives else ""
        unit = swept.summary.unit
        print_message(f"bc-sweep: {run}: RMSE {unit.of(swept.summary.rmse_deg):.2f} {unit.name}{driven}")


def _table(name: str, done: Sequence[Swept]) -> Table:
    """A row for each setting: the mean over its seeds, and the least and the largest."""
    unit = next((swept.summary.unit for swept in done if swept.summary is not None), DEGREES)
    title = f"{printable(name)}: means over the seeds (least to largest); RMSE of frames held out, in {unit.name}"
    table = plain_table(title, "settings", "seeds", "failed", "RMSE", "interventions/km", "autonomy, %")
    ordered = sorted(done, key=lambda swept: swept.training.varied)
    for varied, members in groupby(ordered, key=lambda swept: swept.training.varied):
        of_setting = list(members)
        whole = [swept.summary for swept in of_setting if not swept.failure and swept.summary is not None]
        table.add_row(
            escape(printable(varied or "all the same")),
            f"{len(of_setting):,}",
            f"{sum(bool(swept.failure) for swept in of_setting):,}" if len(whole) < len(of_setting) else "",
            _spread([unit.of(summary.rmse_deg) for summary in whole], 2),
            _spread([summary.interventions_per_km for summary in whole], 2),
            _spread([_mean(summary) for summary in whole], 1),
        )
    return table


def _mean(summary: RunSummary) -> float:
    """Autonomy in percent, over all drives of a run."""
    drives = [float(drive["autonomy_percent"]) for drive in summary.drives if "autonomy_percent" in drive]
    return statistics.fmean(drives) if drives else math.nan


def _spread(values: Sequence[float], digits: int) -> str:
    finite = [value for value in values if math.isfinite(value)]
    if not finite:
        return "-"
    mean = f"{statistics.fmean(finite):.{digits}f}"
    return mean if len(finite) == 1 else f"{mean} ({min(finite):.{digits}f} to {max(finite):.{digits}f})"


def main() -> None:
    run_command("bc-sweep", Sweep, sweep)
