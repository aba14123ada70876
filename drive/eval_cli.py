"""`bc-eval`: how well a trained network drives, in numbers."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.table import Table

from common import UserError
from common.command import DONE, run_command, stderr, stdout

if TYPE_CHECKING:
    from drive.closed_loop import Result


@dataclass(frozen=True)
class Eval:
    """Let a trained network drive the built-in simulator, and measure how well it does.

    Every drive is in lock-step, so that the same run always gives the same numbers, and is logged.
    """

    run: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN]")] = None
    """The run, by name or folder; the newest one by default."""
    simulator: tuple[str, ...] = ("lake", "mountain")
    """Tracks to drive: lake, mountain, random:SEED."""
    laps: float = 1.0
    """How far to drive on each."""
    speed: tuple[float, ...] = (10.0,)
    """Set speeds in mph; every track is driven at each."""
    logs: Path = Path("drives")
    """Folder for the drives' logs."""
    runs: Path = Path("runs")
    """Where runs are kept."""
    json: bool = False
    """Print one JSON object a drive, and no table."""
    force: bool = False
    """Replace logs of the same names."""


def evaluate(config: Eval) -> int:
    from drive.closed_loop import Course
    from drive.closed_loop import evaluate as evaluate_run
    from model import find_run, load_pilot

    if not config.simulator or not config.speed:
        raise UserError("nothing to drive: give --simulator at least one track, and --speed at least one speed")
    pilot = load_pilot(find_run(config.run, config.runs))
    pilot.get_ready()
    courses = [Course(track, config.laps, speed) for speed in config.speed for track in config.simulator]
    console = stderr()
    results = []
    try:
        for result in evaluate_run(
            pilot,
            courses,
            config.logs,
            overwrite=config.force,
            said=lambda text: console.print(f"bc-eval: {text}"),
        ):
            results.append(result)
            if config.json:
                print(json.dumps(result.as_dict()), flush=True)
    finally:  # what was measured is shown, whatever stops the rest
        if results and not config.json:
            stdout().print(_table(results))
            print(f"look at a drive with `bc-play {results[-1].log}`", flush=True)
    return DONE


def _table(results: list[Result]) -> Table:
    # narrow enough for a terminal of 80 columns
    title = "distances from the centre line are shares of the road's half width"
    table = Table(title=title, box=None, pad_edge=False)
    for heading in ("track", "set mph", "mph", "laps", "interventions", "autonomy", "mean", "largest", "steer/s"):
        table.add_column(heading, justify="left" if heading == "track" else "right", no_wrap=True)
    for result in results:
        book = result.book
        table.add_row(
            result.course.track,
            f"{result.course.set_speed_mph:g}",
            f"{book['mean_speed_mph']:.1f}",
            f"{book['laps']:.2f}",
            str(book["interventions"]),
            f"{book['autonomy_percent']:.1f} %",
            f"{book['mean_offset']:.2f}",
            f"{book['max_offset']:.2f}",
            f"{book['steering_per_s']:.2f}",
        )
    return table


def main() -> None:
    run_command("bc-eval", Eval, evaluate)
