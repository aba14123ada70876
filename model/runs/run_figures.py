"""Two pictures of a run for a paper: how training went, and how the network steers the frames held out.

    write_run_figures(Path("runs/first"), predicted, recorded)

Matplotlib is an extra: `pip install ".[figures]"`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from common.errors import counted
from common.steering_unit import DEGREES, assumed_deg
from dataset import MAX_STEERING_DEG
from dataset.figure_style import BLUE, DPI, GREEN, GREY, ORANGE, figure_style, new_figure, require_matplotlib
from model.errors import RunError
from model.metrics import Measures, measure
from model.runs.history import History, read_history
from model.runs.run_files import CURVES, STEERING, replaced_file
from model.runs.training_progress import Epoch

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MAX_MARKED: Final = 40  # epochs: beyond that, marks touch each other
_TICKS: Final = (-1.0, -0.5, 0.0, 0.5, 1.0)
_FARTHEST: Final = 1.25  # a prediction beyond is drawn at the edge

Floats = NDArray[np.float64]


def write_run_figures(run: Path, predicted: Floats, recorded: Floats) -> list[Path]:
    """Draw the run's metrics (curves.png), and the network's steering (N,) of the frames held out, in their order,
    against the recorded one (steering.png). Both are replaced: they belong to the run. Their paths.

    Same run, steering and matplotlib: the same bytes. Raises RunError if metrics.jsonl cannot be used, or if
    matplotlib is not installed.
    """
    require_matplotlib(RunError)
    history, skipped = read_history(run)
    if len(skipped):
        raise RunError(
            f"{run}: no figures, because parts of its history cannot be read: {'; '.join(skipped.lines())}"
        )
    max_deg = history.epochs[-1].measures.max_deg if history.epochs else MAX_STEERING_DEG
    draw: dict[str, Callable[[], Figure]] = {
        CURVES: lambda: draw_curves(history),
        STEERING: lambda: draw_steering(predicted, recorded, max_deg),
    }
    with figure_style():
        for name, figure in draw.items():
            with replaced_file(run / name) as part:
                figure().savefig(part, format="png", dpi=DPI)
    return [run / name for name in draw]


def draw_curves(history: History) -> Figure:
    """Losses and errors by epoch, beside those of constant predictors; the best epoch is marked."""
    figure = new_figure(3.2)
    loss, errors = figure.subplots(1, 2)
    epochs = history.epochs
    unit = epochs[-1].measures.unit if epochs else DEGREES
    marker = "." if len(epochs) <= _MAX_MARKED else ""

    def curve(axes: Axes, value: Callable[[Epoch], float], label: str, **style: Any) -> None:
        values = [value(epoch) for epoch in epochs]
        if np.isfinite(values).any():
            axes.plot([epoch.epoch for epoch in epochs], values, label=label, **style)

    curve(loss, lambda epoch: epoch.training_loss, "training", color=BLUE, marker=marker)
    curve(loss, lambda epoch: epoch.validation_loss, "validation", color=ORANGE, marker=marker)
    network: tuple[tuple[str, str, Callable[[Epoch], float]], ...] = (
        ("RMSE", ORANGE, lambda epoch: unit.of(epoch.measures.network.rmse_deg)),
        ("balanced RMSE", GREEN, lambda epoch: unit.of(epoch.measures.balanced_rmse_deg)),
        ("MAE while turning", BLUE, lambda epoch: unit.of(epoch.measures.network.turning_mae_deg)),
    )
    for label, color, value in network:
        curve(errors, value, label, color=color, marker=marker)
    best = history.best
    if best is None or not best.measures.bins:
        _write_note(errors, "no frames were held out")
    else:
        _draw_constants(loss, errors, best)
        for axes, height in ((loss, best.validation_loss), (errors, unit.of(best.measures.balanced_rmse_deg))):
            axes.axvline(best.epoch, color=GREY, linewidth=0.6, zorder=0)
            style = {"color": "black", "fillstyle": "none", "markersize": 8, "linestyle": ""}
            axes.plot(best.epoch, height, "o", label=f"best: epoch {best.epoch}", **style)
    for axes in (loss, errors):
        axes.set_xlabel("epoch")
        _whole_epochs(axes, epochs)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(
                loc="lower left",
                bbox_to_anchor=(0, 1),
                ncols=2,
                borderaxespad=0.3,
                columnspacing=1,
                handlelength=1.5,
            )
    targets = ", ".join(("steering", *(of.target for epoch in epochs[:1] for of in epoch.targets)))
    loss.set_ylabel(f"mean squared error of {targets}")
    if 0 < loss.dataLim.minposy < math.inf:
        loss.set_yscale("log")
    errors.set_ylabel(f"error on frames held out ({unit.name})")
    errors.set_ylim(0, 1.05 * errors.dataLim.ymax if np.isfinite(errors.dataLim.ymax) else None)
    return figure


def draw_steering(predicted: Floats, recorded: Floats, max_deg: float | None = MAX_STEERING_DEG) -> Figure:
    """Predicted against recorded steering (N,) of the frames held out."""
    figure = new_figure(5.4 if len(recorded) else 1)
    axes = figure.subplots()
    if len(recorded):
        _draw_scatter(axes, predicted, recorded, measure(predicted, recorded, max_deg=max_deg))
    else:
        _write_note(axes, "no frames were held out")
    return figure


def _draw_constants(loss: Axes, errors: Axes, epoch: Epoch) -> None:
    """Draw the errors of predictors that know nothing on the same frames: the same in every epoch."""
    mean, zero = epoch.measures.mean, epoch.measures.zero
    for constant, label, style in ((mean, "always the mean", "--"), (zero, "always zero", ":")):
        squared = (constant.rmse_deg / assumed_deg(epoch.measures.max_deg)) ** 2
        # the axis is logarithmic; of a sum over targets, steering is a part
        if squared > 0 and not epoch.targets:
            loss.axhline(squared, color=GREY, linestyle=style, linewidth=1, label=label)
    balanced = epoch.measures.mean_balanced_rmse_deg
    for value, color in ((mean.rmse_deg, ORANGE), (balanced, GREEN), (mean.turning_mae_deg, BLUE)):
        if math.isfinite(value):
            errors.axhline(epoch.measures.unit.of(value), color=color, linestyle="--", linewidth=1)
    errors.plot([], [], color=GREY, linestyle="--", linewidth=1, label="always the mean")


def _write_note(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=GREY)
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def _whole_epochs(axes: Axes, epochs: Sequence[Epoch]) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    if epochs:
        first, last = epochs[0].epoch, epochs[-1].epoch
        margin = max(0.5, 0.03 * (last - first))
        axes.set_xlim(first - margin, last + margin)


def _draw_scatter(axes: Axes, predicted: Floats, recorded: Floats, measures: Measures) -> None:
    alpha = min(1.0, max(0.05, 300 / len(recorded)))
    axes.plot((-_FARTHEST, _FARTHEST), (-_FARTHEST, _FARTHEST), color=GREY, linewidth=0.8)
    shown = np.clip(predicted, -_FARTHEST, _FARTHEST)
    axes.scatter(recorded, shown, s=6, color=BLUE, alpha=alpha, linewidth=0, clip_on=False)
    rmse = f"{measures.unit.of(measures.network.rmse_deg):.2f}{measures.unit.sign}"
    title = f"{counted(len(recorded), 'frame')} held out: RMSE {rmse}"
    if math.isfinite(measures.network.correlation):
        title += f", correlation {measures.network.correlation:.2f}"
    if beyond := int((np.abs(predicted) > _FARTHEST).sum()):
        title += f"\n({beyond:,} beyond ±{_FARTHEST} drawn at the edge)"
    axes.set_title(title, loc="left", fontsize=8)
    axes.set(xlim=(-1.03, 1.03), ylim=(-_FARTHEST, _FARTHEST), xticks=_TICKS, yticks=_TICKS)
    full = "full lock" if measures.max_deg is None else f"{measures.max_deg:g}°"
    axes.set_xlabel(f"recorded steering (1: {full} to the right)")
    axes.set_ylabel("predicted steering")
