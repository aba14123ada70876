"""The tables and lines that `bc-eval compare` prints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from common.errors import counted, decimal, printable
from common.output import plain_table, print_message, print_result, print_table
from common.steering_unit import DEGREES, SteeringUnit
from model.evaluation.differences import BLOCK_S, CONFIDENCE, FEWEST_BLOCKS, Difference, Verdict, overall
from model.evaluation.run_comparison import Comparison

if TYPE_CHECKING:
    from drive.evaluation.drive_comparison import DriveComparison  # loads the server


def print_comparison(comparison: Comparison, names: Sequence[str]) -> None:
    errors = comparison.a.measures
    length = f" of {BLOCK_S:g} s" if comparison.units == "blocks" else ""
    units = f"{counted(comparison.unit_count, comparison.units.removesuffix('s'))}{length}"
    title = f"{counted(len(comparison.unit), 'frame')} in {units}; errors in {errors.unit.name}"
    print_table(_table(title, comparison.differences, names, errors.unit), "")
    apart = decimal(errors.unit.of(comparison.answers_apart_deg), 2)
    print_result(f"their answers are {apart} {errors.unit.name} apart (RMS)")
    _print_verdict(overall(comparison.differences), comparison.differences, comparison.tolerance, comparison.units)
    mean = errors.unit.of(errors.mean.rmse_deg)
    if errors.network.rmse_deg >= errors.mean.rmse_deg:
        print_message(
            f"bc-eval: on these frames, A is no better than always predicting the mean (RMSE {mean:.2f}): a"
            " network that goes straight might pass as well"
        )


def print_drive_comparison(comparison: DriveComparison, names: Sequence[str]) -> None:
    headings = ("track", "set mph", "interventions", "", "autonomy", "", "mean offset", "")
    drives = plain_table("each drive, A then B", *headings)
    for a, b in zip(comparison.a, comparison.b, strict=True):
        drives.add_row(
            a.simulator.track,
            f"{a.config.set_speed_mph:g}",
            *(f"{drive.report['interventions']:,}" for drive in (a, b)),
            *(f"{drive.report['autonomy_percent']:.1f} %" for drive in (a, b)),
            *(f"{drive.report['mean_offset']:.3f}" for drive in (a, b)),
        )
    title = (
        f"{counted(len(comparison.a), 'drive')}, {counted(comparison.stretches, 'stretch', 'stretches')} of road"
    )
    print_table(drives, "", _table(title, comparison.differences, names), "")
    if comparison.gave_up:
        print_result(f"B is worse: it did not finish {', '.join(comparison.gave_up)}, and A did")
    else:
        _print_verdict(comparison.verdict, comparison.differences, comparison.tolerance, "stretches of road")


def _print_verdict(verdict: Verdict, differences: Sequence[Difference], tolerance: float, units: str) -> None:
    headings = {
        kind: ", ".join(difference.measure.heading for difference in differences if difference.verdict == kind)
        for kind in ("worse", "better")
    }
    beyond = f", beyond the tolerance of {tolerance:.0%}" if tolerance else ""
    if verdict == "worse":
        print_result(f"B is worse than A: {headings['worse']}{beyond}")
    elif verdict == "better":
        print_result(f"B is better than A: {headings['better']}; no measure shows it to be worse{beyond}")
    elif verdict == "not told apart":
        print_result(f"B is not shown to be worse than A{beyond}")
    else:
        print_message(f"no verdict: at least {FEWEST_BLOCKS} {units} are needed", style="yellow")


def _table(
    title: str, differences: Sequence[Difference], names: Sequence[str], unit: SteeringUnit = DEGREES
) -> Table:
    name_a, name_b = (escape(printable(name)) for name in names)
    headings = ("", "A", "B", "B - A", f"{CONFIDENCE:.0%} of all", "B is")
    table = plain_table(f"A: {name_a}\nB: {name_b}\n{title}", *headings, text={"B is"})
    for difference in differences:
        is_count = difference.measure.name == "interventions"
        digits = 0 if is_count else 3 if difference.measure.scale == 1.0 else 2
        per_deg = unit.per_deg if difference.measure.name.endswith("_deg") else 1.0
        a, b, low, high = (
            per_deg * value for value in (difference.a, difference.b, difference.low, difference.high)
        )
        table.add_row(
            difference.measure.heading,
            decimal(a, digits),
            decimal(b, digits),
            _signed(b - a, digits),
            "-" if math.isnan(low) else f"{_signed(low, digits)} .. {_signed(high, digits)}",
            difference.verdict,
        )
    return table


def _signed(value: float, digits: int) -> str:
    return decimal(value, digits, signed=True)
