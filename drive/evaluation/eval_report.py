"""The tables that bc-eval prints for recorded frames and for drives."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.bar import Bar
from rich.markup import escape
from rich.table import Table

from common.errors import counted, decimal, printable
from common.files import short_path
from common.output import plain_table, print_message, print_result, print_table
from common.steering_unit import DEGREES, SteeringUnit
from dataset.prediction_targets import TARGETS
from model.evaluation.differences import BLOCK_S, CONFIDENCE, FEWEST_BLOCKS, Difference, Verdict, overall
from model.evaluation.evaluate import Evaluation
from model.evaluation.run_comparison import Comparison
from model.metrics import Measures, TargetErrors
from model.runs.answer_scale import AnswerScale
from model.runs.run_files import run_argument
from model.runs.run_folder import run_name
from model.runs.worst_pictures import WorstFrame

if TYPE_CHECKING:
    from drive.evaluation.closed_loop import DriveResult  # loads the server
    from drive.evaluation.drive_comparison import DriveComparison  # loads the server


BAR_CELLS = 16  # so that a line fits 80 columns
LATER_BY = 0.02  # a smaller gain of correlation at a later time is not shown


def print_evaluation(evaluation: Evaluation, worst: Sequence[WorstFrame], *, bins: bool = False) -> None:
    """Print the tables, with `bins` also that of steering bins, then the commands that show the `worst` frames."""
    tables = [_measures_table(evaluation)]
    if evaluation.other_targets:
        tables.append(_targets_table(evaluation.other_targets))
    if bins:
        tables.append(_bins_table(evaluation.measures))
    if len(evaluation.sessions) > 1:
        tables.append(_sessions_table(evaluation.sessions))
    if worst:
        tables.append(_worst_table(worst, evaluation.measures.unit))
    for table in tables:
        print_table(table, "")
    if worst:
        print_result("look at them, the worst one first:")
        for frame in worst:
            place = evaluation.logs[frame.session]
            log = shlex.quote(str(short_path(place) if isinstance(place, Path) else place))
            since_begin_ns = frame.log_time_ns - evaluation.begins_ns[frame.session]
            at_ms = -(-since_begin_ns // 1_000_000)  # not before the frame
            print_result(f"    bc-play {log} --at {at_ms / 1000:.3f} --run {run_argument(evaluation.run)}")
        print_result()


def print_drives(results: Sequence[DriveResult]) -> None:
    table = plain_table(
        "distances from the centre line are shares of the road's half width",
        *("track", "set mph", "mph", "laps", "interventions", "autonomy", "mean", "largest", "steer/s"),
    )
    for result in results:
        report = result.report
        table.add_row(
            result.simulator.track,
            f"{result.config.set_speed_mph:g}",
            f"{report['mean_speed_mph']:.1f}",
            f"{report['laps']:.2f}",
            f"{report['interventions']:,}",
            f"{report['autonomy_percent']:.1f} %",
            f"{report['mean_offset']:.2f}",
            f"{report['max_offset']:.2f}",
            f"{report['steering_per_s']:.2f}",
        )
    print_table(table)
    print_result(f"look at a drive with `bc-play {shlex.quote(str(results[-1].log))}`")


def _measures_table(evaluation: Evaluation) -> Table:
    measures, balanced = evaluation.measures, evaluation.balanced_rmse_deg
    shown = measures.unit.of
    predictors = {"network": measures.network, "zero": measures.zero, "mean": measures.mean}
    is_scaled = evaluation.answers != AnswerScale()
    name = escape(printable(run_name(evaluation.run)))
    title = f"{name}: {counted(measures.frames, 'frame')}; errors in {measures.unit.name}"
    as_learnt = ("as learnt",) if is_scaled else ()
    table = plain_table(title, "", "network", "always zero", "always the mean", *as_learnt)
    columns = [*predictors.values(), evaluation.as_learnt] if is_scaled else [*predictors.values()]
    for heading, name in (("MAE", "mae_deg"), ("RMSE", "rmse_deg"), ("MAE on turns", "turning_mae_deg")):
        table.add_row(heading, *(_number(shown(getattr(errors, name))) for errors in columns))
    table.add_row("balanced RMSE", *(_number(shown(balanced[name])) for name in predictors))
    table.add_row("correlation", *(_number(errors.correlation) for errors in predictors.values()))
    reaction = evaluation.reaction_time
    if reaction is not None and reaction.correlation >= reaction.at_once + LATER_BY:
        table.add_row(f"{reaction.delay_s:.2f} s later", _number(reaction.correlation), "-", "-")
    if (others := evaluation.without_crashes) is not None:
        heading = f"RMSE without crashes ({evaluation.crashes:,})"
        table.add_row(
            heading, *(_number(shown(errors.rmse_deg)) for errors in (others.network, others.zero, others.mean))
        )
    if is_scaled:
        table.caption = f"answers: {evaluation.answers.in_words(evaluation.max_deg)}"
    return table


def _targets_table(targets: Sequence[TargetErrors]) -> Table:
    headings = ("other targets", "frames", "MAE", "RMSE", "always the mean", "bias", "correlation")
    table = plain_table("other targets, compared with the recording", *headings)
    for errors in targets:
        unit = TARGETS[errors.target].unit
        numbers = (errors.mae, errors.rmse, errors.mean_rmse, errors.bias, errors.correlation)
        table.add_row(
            f"{errors.target}{f', {unit}' if unit else ''}", f"{errors.frames:,}", *map(_number, numbers)
        )
    return table


def _bins_table(measures: Measures) -> Table:
    title = "by recorded steering; bias above 0: too far right"
    table = plain_table(title, "steering", "frames", "MAE", "bias", "RMSE", "")
    shown = measures.unit.of
    widest = max(part.rmse_deg for part in measures.bins)
    for part in measures.bins:
        table.add_row(
            f"{part.low:+.2f} .. {part.high:+.2f}",
            f"{part.frames:,}",
            _number(shown(part.mae_deg)),
            f"{shown(part.bias_deg):+.2f}",
            _number(shown(part.rmse_deg)),
            Bar(widest or 1.0, 0, part.rmse_deg, width=BAR_CELLS),
        )
    return table


def _sessions_table(sessions: dict[str, Measures]) -> Table:
    title = "by session; mean: always predicting it"
    table = plain_table(title, "session", "frames", "MAE", "RMSE", "mean RMSE", "on turns", "correlation")
    for session, measures in sessions.items():
        errors, shown = measures.network, measures.unit.of
        table.add_row(
            escape(printable(session)),
            f"{measures.frames:,}",
            _number(shown(errors.mae_deg)),
            _number(shown(errors.rmse_deg)),
            _number(shown(measures.mean.rmse_deg)),
            _number(shown(errors.turning_mae_deg)),
            _number(errors.correlation),
        )
    return table


def _worst_table(worst: Sequence[WorstFrame], unit: SteeringUnit) -> Table:
    table = plain_table(
        f"worst frames, in {unit.name}", "session", "row", "log time (UTC)", "predicted", "recorded", "error"
    )
    for frame in worst:
        table.add_row(
            escape(printable(frame.session)),
            f"{frame.row:,}",
            frame.log_time_utc.removesuffix("+00:00").replace("T", " "),
            f"{unit.of(frame.predicted_deg):+.2f}",
            f"{unit.of(frame.recorded_deg):+.2f}",
            f"{unit.of(frame.error_deg):+.2f}",
        )
    return table


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f}"


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
