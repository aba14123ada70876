"""A run's training in the viewer: losses, errors beside those of constant predictors, and errors by steering."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from common import UserError
from common.steering_unit import DEGREES, SteeringUnit, assumed_deg
from common.untrusted import real_path
from dataset.prediction_targets import TARGETS, TargetName
from model.metrics import Errors, Measures
from model.runs.history import History, HistoryReader, read_history
from model.runs.run_lock import is_being_trained
from model.runs.training_progress import METRICS_FILE, STEPS_FILE, Epoch, Step
from model.target_metrics import TargetErrors
from viz.console import print_error, print_notice, print_skipped
from viz.playback.blueprint import BLUE, GREEN, GREY, ORANGE
from viz.playback.rerun_recording import PreparedRecording
from viz.viewer_feed import POLL_S, ViewerFeed, ViewerGoneError, feed_viewer
from viz.viewer_process import Viewer
from viz.worst_frames import send_worst, worst_views

SAMPLES: Final = "samples"  # learnt from since the run began: what all curves are drawn over
EPOCH: Final = "epoch"

_MAX_NAMES: Final = 5  # in an error

_DARK_GREY: Final = (100, 100, 100)


@dataclass(frozen=True)
class _Line:
    """A line of a plot: a value of every epoch."""

    entity: str
    name: str
    color: tuple[int, int, int]
    value: Callable[[Epoch], float]


def _squared(errors: Errors, of: Measures) -> float:
    """The mean squared error of steering (-1..1) for a root in degrees."""
    return (errors.rmse_deg / assumed_deg(of.max_deg)) ** 2


_LINES: Final = (
    _Line("/loss/training", "training", BLUE, lambda epoch: epoch.training_loss),
    _Line("/loss/validation", "validation", ORANGE, lambda epoch: epoch.validation_loss),
    _Line("/rmse_deg/network", "network", ORANGE, lambda epoch: epoch.measures.network.rmse_deg),
    _Line("/rmse_deg/balanced", "balanced", GREEN, lambda epoch: epoch.measures.balanced_rmse_deg),
    _Line("/rmse_deg/mean", "always the mean", GREY, lambda epoch: epoch.measures.mean.rmse_deg),
    _Line("/rmse_deg/zero", "always zero", _DARK_GREY, lambda epoch: epoch.measures.zero.rmse_deg),
    _Line("/turning_mae_deg/network", "network", ORANGE, lambda epoch: epoch.measures.network.turning_mae_deg),
    _Line("/turning_mae_deg/mean", "always the mean", GREY, lambda epoch: epoch.measures.mean.turning_mae_deg),
    _Line("/turning_mae_deg/zero", "always zero", _DARK_GREY, lambda epoch: epoch.measures.zero.turning_mae_deg),
)

_STEERING_LOSSES: Final = (
    _Line("/loss/mean", "always the mean", GREY, lambda epoch: _squared(epoch.measures.mean, epoch.measures)),
    _Line("/loss/zero", "always zero", _DARK_GREY, lambda epoch: _squared(epoch.measures.zero, epoch.measures)),
)
"""Beside a loss of steering alone: of a sum over targets they would be a part."""


def _lines_of(targets: Sequence[TargetName]) -> tuple[_Line, ...]:
    """All lines of a training that has these targets besides steering."""
    of_targets = tuple(line for target in targets for line in _target_lines(target))
    return _LINES + (of_targets or _STEERING_LOSSES)


def _target_lines(target: TargetName) -> tuple[_Line, ...]:
    """The lines of a target besides steering."""

    def of(epoch: Epoch) -> TargetErrors | None:
        return next((each for each in epoch.targets if each.target == target), None)

    def network(epoch: Epoch) -> float:
        return math.nan if (found := of(epoch)) is None else found.rmse

    def mean(epoch: Epoch) -> float:
        return math.nan if (found := of(epoch)) is None else found.mean_rmse

    return (
        _Line(f"/{target}_rmse/network", "network", ORANGE, network),
        _Line(f"/{target}_rmse/mean", "always the mean", GREY, mean),
    )


def _with_unit(target: TargetName) -> str:
    unit = TARGETS[target].unit
    return f"{target}, {unit}" if unit else target


_STEPS: Final = "/loss/steps"
_BEST: Final = "/rmse_deg/best"


def refuse_no_training(folder: Path, *, is_awaited: bool) -> None:
    """Raise UserError for a folder in which nothing was trained, before a viewer opens to show it. `is_awaited`: a
    training in it may begin yet."""
    if not folder.is_dir() or _is_trained(folder):
        return
    within = sorted(folder.iterdir())
    found = [str(path) for path in within if path.suffix == ".mcap" or _is_trained(path)]
    if found:
        some = ", ".join(found[:_MAX_NAMES]) + (", ..." if len(found) > _MAX_NAMES else "")
        raise UserError(f"{folder}: no training in it, but logs or runs: give one of them, {some}")
    if not is_awaited:
        read_history(folder)


def _is_trained(folder: Path) -> bool:
    return any((folder / name).exists() for name in (METRICS_FILE, STEPS_FILE))


@contextlib.contextmanager
def prepare_training(run: Path) -> Iterator[PreparedRecording]:
    """Prepare the training of `run` as far as it has come. Raises RunError if `run` holds no training."""
    history, skipped = read_history(run)
    notices = [f"skipped {line}" for line in skipped.lines()]
    yield PreparedRecording(
        _name(run), None, lambda recording, flush, _: _send_whole(history, recording, flush), notices
    )


def _send_whole(history: History, recording: rr.RecordingStream, flush: Callable[[], object]) -> None:
    TrainingSender(recording).send(history)
    flush()


def wait_until_trained(run: Path) -> None:
    """Return when no process of this machine trains `run` (any more)."""
    while is_being_trained(run):
        time.sleep(POLL_S)


def follow_training(run: Path, url: str, viewer: Viewer | None) -> int:
    """Show the training of `run` as it goes on in the viewer at `url`, until that is closed; the exit code.

    Without its process (`viewer`), the viewer is another's.

    Trouble with the run is printed on stderr when it happens, and the viewer stays open. Raises UserError if
    the viewer does not start, or dies.
    """
    return feed_viewer(_TrainingFeed(run, url), viewer)


def training_layout(
    *, has_errors: bool, targets: Sequence[TargetName] = (), unit: SteeringUnit = DEGREES
) -> rrb.Blueprint:
    """The layout for a training, with a view for each of `targets` besides steering; where nothing was held out,
    there is no view for errors."""
    of = f"errors of steering, {', '.join(targets)}, summed up" if targets else "error of steering -1 .. 1"
    loss = _plot("/loss", f"loss: mean squared {of}")
    errors = (
        _plot("/rmse_deg", f"frames held out: RMSE, {unit.name}"),
        _plot("/turning_mae_deg", f"turning frames held out: MAE, {unit.name}"),
        *(_plot(f"/{name}_rmse", f"frames held out: RMSE of {_with_unit(name)}") for name in targets),
    )
    bins = (
        rrb.BarChartView(origin="/bins/rmse_deg", name=f"RMSE in {unit.name} by steering, -1 left .. 1 right"),
        rrb.BarChartView(origin="/bins/frames", name="frames held out by steering"),
    )
    details = rrb.Vertical(*bins, worst_views(), row_shares=[1, 1, 2])
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(loss, *errors), details, column_shares=[3, 2]) if has_errors else
        loss,
        rrb.TimePanel(state="collapsed", timeline=SAMPLES, play_state="following"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )  # fmt: skip


class TrainingSender:
    """Sends a training to a recording, as far as it has come, with its layout."""

    def __init__(self, recording: rr.RecordingStream) -> None:
        self._recording = recording
        # has errors, of which other targets, in which unit
        self._laid_out: tuple[bool, tuple[TargetName, ...], SteeringUnit] | None = None
        self._lines: tuple[_Line, ...] = ()
        self._has_epochs = False
        self._ends: dict[int, int] = {}  # of each epoch, in samples

    def send(self, history: History) -> None:
        """Send the new part of a training; the steps of its epochs come with them, or came before."""
        has_errors = not history.epochs or any(epoch.measures.bins for epoch in history.epochs)
        targets = tuple(of.target for epoch in history.epochs[:1] for of in epoch.targets)
        # The first epoch decides; a later one must not undo the user's changes of the layout.
        layout = has_errors, targets, history.epochs[0].measures.unit if history.epochs else DEGREES
        if self._laid_out is None or (not self._has_epochs and layout != self._laid_out):
            self._lines = _lines_of(targets)
            self._prepare(*layout)
        self._has_epochs = self._has_epochs or bool(history.epochs)
        self._send_steps(history.steps)
        self._ends.update((step.epoch, step.samples) for step in history.steps)
        # without its steps, an epoch is drawn at its number
        self._send_epochs(history.epochs, [self._ends.get(epoch.epoch, epoch.epoch) for epoch in history.epochs])
        for worst in history.worst:
            send_worst(
                self._recording, worst, [(SAMPLES, self._ends.get(worst.epoch, worst.epoch)), (EPOCH, worst.epoch)]
            )

    def _prepare(self, has_errors: bool, targets: tuple[TargetName, ...], unit: SteeringUnit) -> None:
        self._laid_out = has_errors, targets, unit
        for line in self._lines:
            style = rr.SeriesLines(names=line.name, colors=[line.color], widths=1.5)
            self._recording.log(line.entity, style, static=True)
        steps = rr.SeriesLines(names="training, last batches", colors=[(*BLUE, 110)], widths=1.0)
        self._recording.log(_STEPS, steps, static=True)
        best = rr.SeriesPoints(names="best so far", colors=[GREEN], markers="circle", marker_sizes=4.0)
        self._recording.log(_BEST, best, static=True)
        self._recording.send_blueprint(training_layout(has_errors=has_errors, targets=targets, unit=unit))

    def _send_steps(self, steps: Iterable[Step]) -> None:
        found = [(step.samples, step.training_loss) for step in steps if math.isfinite(step.training_loss)]
        if found:
            samples, losses = zip(*found, strict=True)
            times = rr.TimeColumn(SAMPLES, sequence=samples)
            self._recording.send_columns(_STEPS, [times], rr.Scalars.columns(scalars=losses))

    def _send_epochs(self, epochs: Iterable[Epoch], samples: Iterable[int]) -> None:
        placed = list(zip(samples, epochs, strict=True))
        best = _Line(_BEST, "", GREEN, lambda epoch: epoch.measures.balanced_rmse_deg)
        for line in self._lines:
            self._send_line(line, placed)
        self._send_line(best, [(at, epoch) for at, epoch in placed if epoch.is_best])
        for at, epoch in placed:
            self._send_bins(at, epoch)

    def _send_line(self, line: _Line, placed: Iterable[tuple[int, Epoch]]) -> None:
        is_angle = "_deg" in line.entity
        points = [
            (at, epoch.epoch, line.value(epoch) * (epoch.measures.unit.per_deg if is_angle else 1))
            for at, epoch in placed
        ]
        points = [point for point in points if math.isfinite(point[2])]
        if points:
            samples, epochs, values = zip(*points, strict=True)
            times = [rr.TimeColumn(SAMPLES, sequence=samples), rr.TimeColumn(EPOCH, sequence=epochs)]
            self._recording.send_columns(line.entity, times, rr.Scalars.columns(scalars=values))

    def _send_bins(self, samples: int, epoch: Epoch) -> None:
        bins = epoch.measures.bins
        if not bins:
            return
        middles = np.array([(part.low + part.high) / 2 for part in bins])
        widths = np.array([0.9 * (part.high - part.low) for part in bins], np.float32)
        for name, values in (
            ("rmse_deg", np.array([epoch.measures.unit.of(part.rmse_deg) for part in bins])),
            ("frames", np.array([part.frames for part in bins])),
        ):
            chart = rr.BarChart(
                values, abscissa=middles, widths=widths, color=ORANGE if name == "rmse_deg" else GREY
            )
            self._recording.set_time(SAMPLES, sequence=samples)
            self._recording.set_time(EPOCH, sequence=epoch.epoch)
            self._recording.log(f"/bins/{name}", chart)


class _TrainingFeed(ViewerFeed):
    """Sends a training. When it is resumed, its files are replaced: all is shown anew, as another recording."""

    def __init__(self, run: Path, url: str) -> None:
        super().__init__(url)
        self._run = run

    def run(self) -> None:
        reader = HistoryReader(self._run)
        self._recording = self._connected(_name(self._run))
        if not self._run.is_dir():  # bc-train makes it when it has read its index
            print_notice(f"waits until {self._run} is trained")
        while not self._run.is_dir() and not self.stop.is_set():
            self.stop.wait(POLL_S)
        try:
            self._send(reader)
        except UserError as error:
            self.code = print_error(error)
        skipped = print_skipped(reader.skipped)
        self.code = self.code or skipped
        self._disconnect(self._recording)

    def _send(self, reader: HistoryReader) -> None:
        sender = TrainingSender(self._recording)
        while not self.stop.is_set():
            history, is_replaced = reader.read()
            if is_replaced:
                self._recording.disconnect()
                self._recording = self._connected(_name(self._run))
                sender = TrainingSender(self._recording)
            sender.send(history)
            try:
                self._flush(self._recording)
            except ViewerGoneError:
                self._raise_if_not_closed()
                return
            self.stop.wait(POLL_S)


def _plot(origin: str, name: str) -> rrb.View:
    """A plot of a whole training: by itself, a viewer that follows shows only the last few samples."""
    whole = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
    return rrb.TimeSeriesView(
        origin=origin,
        name=name,
        axis_x=rrb.TimeAxis(view_range=whole),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
    )


def _name(run: Path) -> str:
    return real_path(run).name
