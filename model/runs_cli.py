"""`bc-runs`: lists trained runs, so that they can be compared."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from rich.markup import escape
from rich.table import Table

from common import UserError
from common.command import DONE, run_command, warn
from common.errors import decimal, printable
from common.location import Url
from common.location_flag import LocationFlag
from common.output import print_result, print_table

if TYPE_CHECKING:
    from model.runs.run_summary import RunSummary

_A_WHOLE_LAP: Final = 0.99  # a drive ends within a telemetry of the line
SORTED_BY: Final[dict[str, Callable[[RunSummary], Any]]] = {
    "newest": lambda run: _descending(run.written_at),
    "name": lambda run: run.name,
    "rmse": lambda run: run.rmse_share,
    "balanced-rmse": lambda run: run.balanced_rmse_share,
    "correlation": lambda run: -run.correlation,
    "interventions": lambda run: run.interventions_per_km,
}
"""The best comes first. Errors are shares of those of always predicting the mean: runs hold out other frames."""


@dataclass(frozen=True)
class Runs:
    """List trained runs, the newest first: what they learnt from, their errors on the frames that they hold out,
    and how they drove (what `bc-eval` has measured of them is kept in their folders).

    bc-runs
    bc-runs --sort interventions
    bc-runs --runs s3://my-bucket/runs
    """

    runs: LocationFlag = Path("runs")
    """Where runs are kept."""
    sort: Literal["newest", "name", "rmse", "balanced-rmse", "correlation", "interventions"] = "newest"
    """By what to order them, the best first; errors as shares of those of always predicting the mean."""
    json: bool = False
    """One JSON object a run, with every kept result, and no table."""


def list_runs(config: Runs) -> int:
    from model.runs.run_summary import summarize_runs

    if isinstance(config.runs, Path) and not config.runs.is_dir():
        problem = "a file, no folder of runs" if config.runs.exists() else "no such folder"
        raise UserError(f"{config.runs}: {problem}; train a run with `bc-train`, or give --runs FOLDER")
    found = list(summarize_runs(config.runs))
    if not found:
        flag = f" --runs {config.runs}" if isinstance(config.runs, Url) else ""
        raise UserError(f"{config.runs}: no run in it; train one with `bc-train{flag}`")
    runs = sorted((run for run in found if not run.problem), key=lambda run: order_of(config.sort, run))
    if config.json:
        _print_json(runs)
    elif runs:
        print_table(_table(runs))
    return max([DONE, *(warn(run.problem) for run in found if run.problem)])


def order_of(by: str, run: RunSummary) -> tuple[bool, Any, str]:
    """The sort key of a run: runs without the number come last."""
    value = SORTED_BY[by](run)
    is_unknown = isinstance(value, float) and math.isnan(value)
    return is_unknown, 0.0 if is_unknown else value, run.name


def _descending(text: str) -> tuple[int, ...]:
    return tuple(-ord(character) for character in text)


def _print_json(runs: Sequence[RunSummary]) -> None:
    import msgspec

    from model.runs.run_files import without_nan

    for run in runs:
        print_result(json.dumps(without_nan(msgspec.to_builtins(dataclasses.asdict(run)))))


def _table(runs: Sequence[RunSummary]) -> Table:
    title = "held-out frames: errors as shares of those of always predicting the mean"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False, collapse_padding=True)
    has_driven = any(run.drives for run in runs)
    headings = ("run", "network", "sessions", "recipe", "epoch", "RMSE", "balanced", "r")
    for heading in (*headings, *(("interventions",) if has_driven else ())):
        is_text = heading in ("run", "network", "recipe", "interventions")
        is_name = heading == "run"  # of any length; no other heading is broken up for it
        least = None if is_name else len(heading)
        table.add_column(heading, justify="left" if is_text else "right", overflow="fold", min_width=least)
    for run in runs:
        table.add_row(
            escape(printable(run.name)),
            escape(printable(_network_words(run))),
            f"{len(run.sessions):,}",
            escape(printable(run.recipe)),
            f"{run.kept_epoch or '-'}/{run.epochs}",
            decimal(run.rmse_share, 2),
            decimal(run.balanced_rmse_share, 2),
            decimal(run.correlation, 2),
            *([escape(printable(driven_words(run.drives)))] if has_driven else []),
        )
    return table


def _network_words(run: RunSummary) -> str:
    """ "original", "small +speed": the network, and what it answers besides steering."""
    return " ".join([run.network, *(f"+{target}" for target in run.targets[1:])])


def driven_words(drives: Sequence[dict[str, Any]]) -> str:
    """The interventions on each track, by speed: "10 mph: lake 0, mountain 1"; and in how much of a lap, where it
    was not a whole one."""
    by_speed = groupby(sorted(drives, key=_speed_mph), key=_speed_mph)
    tracks = {
        speed: ", ".join(f"{drive['track']} {drive['interventions']}{_part_of_lap(drive)}" for drive in part)
        for speed, part in by_speed
    }
    return "; ".join(f"{speed:g} mph: {driven}" for speed, driven in tracks.items())


def _part_of_lap(drive: Mapping[str, Any]) -> str:
    laps = drive.get("laps")
    is_part = isinstance(laps, int | float) and 0 <= laps < _A_WHOLE_LAP
    return f" in {laps:.2f} laps" if is_part else ""


def _speed_mph(drive: dict[str, Any]) -> float:
    return float(drive["set_speed_mph"])


def main() -> None:
    run_command("bc-runs", Runs, list_runs)
