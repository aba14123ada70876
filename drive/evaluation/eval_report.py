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

from common.errors import counted, printable
from common.files import short_path
from common.output import plain_table, print_result, print_table
from common.steering_unit import SteeringUnit
from dataset.prediction_targets import TARGETS
from model.evaluation.evaluate import Evaluation
from model.metrics import Measures, TargetErrors
from model.runs.answer_scale import AnswerScale
from model.runs.run_arguments import run_argument
from model.runs.run_folder import run_name
from model.runs.worst_pictures import WorstFrame

if TYPE_CHECKING:
    from drive.evaluation.closed_loop import DriveResult  # loads the server

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
