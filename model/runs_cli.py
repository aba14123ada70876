"""`bc-runs`: list trained runs, to compare them."""

from __future__ import annotations

import dataclasses
import json
import math
import shlex
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
from common.output import print_message, print_next, print_result, print_table

if TYPE_CHECKING:
    from model.runs.run_summary import RunSummary

SORTED_BY: Final[dict[str, Callable[[RunSummary], Any]]] = {
    "newest": lambda run: tuple(-ord(character) for character in run.written_at),
    "name": lambda run: run.name,
    "rmse": lambda run: run.rmse_share,
    "balanced-rmse": lambda run: run.balanced_rmse_share,
    "correlation": lambda run: -run.correlation,
    "interventions": lambda run: run.interventions_per_km,
}
"""The sort keys of --sort: the best run comes first. Errors are divided by those of always predicting the mean."""
_BY_HELD_OUT: Final = ("rmse", "balanced-rmse", "correlation")


@dataclass(frozen=True)
class Runs:
    """List runs, the newest first: what they learnt from, held-out errors, and kept results of drives.

    bc-runs
    bc-runs --sort interventions
    """

    runs: Path = Path("runs")
    """The runs."""
    sort: Literal["newest", "name", "rmse", "balanced-rmse", "correlation", "interventions"] = "newest"
    """Order of the list, best first; runs with the same held-out frames together."""
    json: bool = False
    """Print one JSON object a run, with every kept result."""


def list_runs(config: Runs) -> int:
    from model.runs.run_files import CONFIG
    from model.runs.run_summary import summarize_runs

    if not config.runs.is_dir():
        problem = "a file, not a folder" if config.runs.exists() else "the folder does not exist"
        raise UserError(f"{config.runs}: {problem}; train a run with `bc-train`, or give --runs FOLDER")
    summaries = list(summarize_runs(config.runs))
    if not summaries and (config.runs / CONFIG).exists():
        folder = shlex.quote(str(config.runs.absolute().parent))
        raise UserError(f"{config.runs}: a run; `bc-runs --runs {folder}` lists those of its folder")
    if not summaries:
        raise UserError(f"{config.runs}: no run in it; train one with `bc-train`")
    runs = in_order([run for run in summaries if not run.problem], config.sort)
    if config.json:
        _print_json(runs)
    elif runs:
        print_table(_table(runs))
        for line in _words_explained(runs):
            print_message(line)
        if notice := different_frames(runs):
            print_message(notice)
        if (verdict := in_order(runs, "newest")[0].verdict) is not None:
            print_next(verdict.advice.command, verdict.advice.why)
    return max([DONE, *(warn(run.problem) for run in summaries if run.problem)])


def in_order(runs: Sequence[RunSummary], by: str) -> list[RunSummary]:
    """The runs, the best first. When sorted by errors on held-out frames, runs with the same frames are grouped;
    the group of the newest run comes first."""
    runs = sorted(runs, key=lambda run: order_of(by, run))
    if by in _BY_HELD_OUT:
        marks = marks_of_splits(runs)
        runs.sort(key=lambda run: (not run.split, marks.get(run.split, "")))
    return runs


def marks_of_splits(runs: Sequence[RunSummary]) -> dict[str, str]:
    """A letter for each split on which runs were measured, "A" for that of the newest run; empty for a single
    split."""
    newest = sorted(runs, key=lambda run: order_of("newest", run))
    splits = dict.fromkeys(run.split for run in newest if run.split)
    return {split: _letters(number) for number, split in enumerate(splits)} if len(splits) > 1 else {}


def _letters(number: int) -> str:
    """A to Z, then ZA, so that the letters sort as the numbers do."""
    return "Z" * (number // 26) + chr(ord("A") + number % 26)


def different_frames(runs: Sequence[RunSummary]) -> str:
    """A line that explains how to measure runs on the same frames; empty if they were already."""
    marks = marks_of_splits(runs)
    if not marks:
        return ""
    first = {run.split: run.name for run in reversed(runs) if run.split}
    lines = " and ".join(
        f"`bc-eval {shlex.quote(printable(first[split]))} --session NAME`" for split in [*marks][:2]
    )
    return (
        f"held-out frames {', '.join(marks.values())} differ: compare errors only within a letter."
        f" {lines}, with a session that no run has learnt, measure runs on the same frames"
    )


def order_of(by: str, run: RunSummary) -> tuple[bool, Any, str]:
    """The sort key of a run: runs without the number come last."""
    value = SORTED_BY[by](run)
    is_unknown = isinstance(value, float) and math.isnan(value)
    return is_unknown, 0.0 if is_unknown else value, run.name


def _print_json(runs: Sequence[RunSummary]) -> None:
    import msgspec

    from model.runs.run_files import without_nan

    for run in runs:
        print_result(json.dumps(without_nan(msgspec.to_builtins(dataclasses.asdict(run)))))


def _table(runs: Sequence[RunSummary]) -> Table:
    title = "held-out frames: errors as shares of those of always predicting the mean"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False, collapse_padding=True)
    has_driven = any(run.drives or run.supervised for run in runs)
    marks = marks_of_splits(runs)
    headings = ("run", "network", "sessions", "recipe", "epoch", *(("frames",) if marks else ()))
    for heading in (*headings, "RMSE", "balanced", "r", "verdict", *(("interventions",) if has_driven else ())):
        is_text = heading in ("run", "network", "recipe", "frames", "interventions", "verdict")
        min_width = None if heading == "run" else len(heading)  # a long name must not break up other headings
        table.add_column(heading, justify="left" if is_text else "right", overflow="fold", min_width=min_width)
    for run in runs:
        table.add_row(
            escape(printable(run.name)),
            escape(printable(_network_words(run))),
            f"{len(run.sessions):,}",
            escape(printable(run.recipe)),
            run.epochs_in_short,
            *([marks.get(run.split, "-")] if marks else []),
            decimal(run.rmse_share, 2),
            decimal(run.balanced_rmse_share, 2),
            decimal(run.correlation, 2),
            run.verdict.in_short if run.verdict else "-",
            *([escape(printable(driven_words(run.drives, run.supervised)))] if has_driven else []),
        )
    return table


def _words_explained(runs: Sequence[RunSummary]) -> list[str]:
    from model.runs.verdict import NO_BETTER, UNKNOWN

    meanings = {
        NO_BETTER: "than always predicting the mean, on turns, in the driving error or in the RMSE",
        UNKNOWN: "nothing was held out, or no epoch has ended, or the steering held out never changes",
    }
    shown = {run.verdict.in_short for run in runs if run.verdict}
    return [f"{word}: {meaning}" for word, meaning in meanings.items() if word in shown]


def _network_words(run: RunSummary) -> str:
    """The network and its targets other than steering: "original", "small +speed"."""
    return " ".join([run.network, *(f"+{target}" for target in run.targets[1:])])


def driven_words(drives: Sequence[dict[str, Any]], supervised: Sequence[dict[str, Any]] = ()) -> str:
    """The interventions on each track, by speed: "10 mph: lake 0, mountain 1", with the laps of a partial lap.
    Then those of supervised drives, with the number of the person's."""
    return "; ".join([*_by_speed(drives), *(f"supervised at {words}" for words in _by_speed(supervised))])


def _by_speed(drives: Sequence[dict[str, Any]]) -> list[str]:
    by_speed = groupby(sorted(drives, key=_speed_mph), key=_speed_mph)
    return [f"{speed:g} mph: {', '.join(_interventions(drive) for drive in part)}" for speed, part in by_speed]


def _interventions(drive: Mapping[str, Any]) -> str:
    from model.runs.verdict import part_of_laps

    persons = f" ({drive['by_person']} by a person)" if drive.get("by_person") else ""
    laps = part_of_laps([drive])
    return f"{drive['track']} {drive['interventions']}{persons}{laps and f' in {laps}'}"


def _speed_mph(drive: dict[str, Any]) -> float:
    return float(drive["set_speed_mph"])


def main() -> None:
    run_command("bc-runs", Runs, list_runs)
