"""The pictures in a run's folder: curves of its training, and its steering of the frames held out."""

from __future__ import annotations

import json
import math
import struct
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dataset import decode
from dataset.figure_style import BLUE, GREEN, ORANGE
from histories import epoch_line, write_lines, write_run
from model import RunError
from model.runs.history import read_history
from model.runs.run_figures import draw_curves, draw_steering, write_run_figures

RECORDED = np.concatenate([np.zeros(400), np.sin(np.arange(200) / 7), np.zeros(400)])
PREDICTED = 0.5 * RECORDED + 0.1


def texts(figure: Figure) -> str:
    return " ".join(text.get_text() for axes in figure.axes for text in (*axes.texts, axes.title))


def lines_of(axes: Axes) -> dict[str, tuple[list[float], list[float]]]:
    """Points of every named line of a panel."""
    return {
        str(line.get_label()): (np.asarray(line.get_xdata()).tolist(), np.asarray(line.get_ydata()).tolist())
        for line in axes.get_lines()
        if not str(line.get_label()).startswith("_")
    }


def curves_of(run: Path) -> tuple[Axes, Axes]:
    history, _ = read_history(run)
    loss, errors = draw_curves(history).axes
    return loss, errors


# The files


def test_both_pictures_are_there_7_inches_wide_at_200_dpi(tmp_path: Path) -> None:
    run = write_run(tmp_path / "first", 3)
    before = set(run.iterdir())
    written = write_run_figures(run, PREDICTED, RECORDED)
    assert written == [run / "curves.png", run / "steering.png"]
    assert set(run.iterdir()) == before | set(written)
    for path in written:
        data = path.read_bytes()
        width, height = struct.unpack(">II", data[16:24])
        assert width == 1400
        assert 500 < height < 1200
        assert np.unique(decode(data)).size > 10


def test_figures_are_replaced_and_equal_whatever_the_users_style(
    tmp_path: Path,
) -> None:
    run = write_run(tmp_path / "first", 2)
    first = [path.read_bytes() for path in write_run_figures(run, PREDICTED, RECORDED)]
    for name in ("curves.png", "steering.png"):
        (run / name).write_bytes(b"an older one")
    with matplotlib.rc_context({"font.size": 20.0, "savefig.facecolor": "red"}):
        again = [path.read_bytes() for path in write_run_figures(run, PREDICTED, RECORDED)]
    assert again == first


def test_without_matplotlib_the_error_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    run = write_run(tmp_path / "first", 1)
    with pytest.raises(RunError, match=r"`pip install .*\[figures\].*`"):
        write_run_figures(run, PREDICTED, RECORDED)
    assert not list(run.glob("*.png"))


def test_a_history_that_cannot_be_read_is_an_error_and_no_picture(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"metrics\.jsonl is missing"):
        write_run_figures(write_run(tmp_path / "empty", 0), PREDICTED, RECORDED)
    run = write_run(tmp_path / "first", 2)
    with (run / "metrics.jsonl").open("a") as stream:
        stream.write("oops\n")
    with pytest.raises(RunError, match=r"metrics\.jsonl line 3"):
        write_run_figures(run, PREDICTED, RECORDED)
    assert not list(run.glob("*.png"))


# The curves


def test_the_curves_are_the_lines_of_metrics_jsonl(tmp_path: Path) -> None:
    run = write_run(tmp_path / "first", 3)
    metrics = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    loss, errors = curves_of(run)
    assert lines_of(loss)["training"] == ([1, 2, 3], [line["training_loss"] for line in metrics])
    assert lines_of(loss)["validation"] == ([1, 2, 3], [line["validation_loss"] for line in metrics])
    shown = lines_of(errors)
    assert shown["RMSE"][1] == [line["validation"]["rmse_deg"] for line in metrics]
    assert shown["MAE while turning"][1] == [line["validation"]["turning_mae_deg"] for line in metrics]
    assert shown["balanced RMSE"][1] == pytest.approx([line["balanced_rmse_deg"] for line in metrics])


def test_what_constant_predictors_reach_stands_beside_the_curves(tmp_path: Path) -> None:
    """The mean squared error of steering, where 1 is 25 degrees, of an error in degrees."""
    of_the_mean = {**epoch_line(1)["mean"], "balanced_rmse_deg": 7.5}
    loss, errors = curves_of(write_run(tmp_path / "first", 2, mean=of_the_mean))
    assert lines_of(loss)["always the mean"][1] == pytest.approx([(4.5 / 25) ** 2] * 2)
    assert lines_of(loss)["always zero"][1] == pytest.approx([(5.0 / 25) ** 2] * 2)
    constant = {
        str(line.get_color()): float(np.asarray(line.get_ydata())[0])
        for line in errors.get_lines()
        if line.get_linestyle() == "--" and len(np.asarray(line.get_ydata()))
    }
    assert constant == {ORANGE: 4.5, GREEN: 7.5, BLUE: 9.0}  # each in the colour of its own curve


def test_a_loss_of_several_targets_has_no_constant_steering_beside_it(tmp_path: Path) -> None:
    speed = {"target": "speed", "frames": 90, "mae": 1, "rmse": 2, "bias": 0, "correlation": 0.9, "mean_rmse": 6}
    loss, _ = curves_of(write_run(tmp_path / "first", 2, targets=[speed]))
    assert not {"always the mean", "always zero"} & lines_of(loss).keys()
    assert loss.get_ylabel() == "mean squared error of steering, speed"


def test_the_last_best_epoch_is_marked(tmp_path: Path) -> None:
    run = tmp_path / "first"
    run.mkdir()
    best = (True, True, False)
    write_lines(run / "metrics.jsonl", [epoch_line(i, is_best=is_best) for i, is_best in enumerate(best, 1)])
    loss, errors = curves_of(run)
    assert lines_of(loss)["best: epoch 2"] == ([2], [0.15])
    epochs, errors_deg = lines_of(errors)["best: epoch 2"]
    assert epochs == [2]
    assert errors_deg == pytest.approx([3.0 * 5**0.5])


def test_one_epoch_is_a_point_that_can_be_seen(tmp_path: Path) -> None:
    loss, _ = curves_of(write_run(tmp_path / "first", 1))
    (training,) = [line for line in loss.get_lines() if line.get_label() == "training"]
    assert training.get_marker() == "."
    assert loss.get_xlim()[0] < 1 < loss.get_xlim()[1]


def test_without_held_out_frames_the_pictures_say_so(tmp_path: Path) -> None:
    run = write_run(tmp_path / "first", 2, frames=0)
    loss, errors = curves_of(run)
    assert set(lines_of(loss)) == {"training"}
    assert "no frames were held out" in [text.get_text() for text in errors.texts]
    assert "no frames were held out" in texts(draw_steering(np.zeros(0), np.zeros(0)))
    assert len(write_run_figures(run, np.zeros(0), np.zeros(0))) == 2


@pytest.mark.parametrize("value", [None, 0.0, 1e90])
def test_numbers_that_are_missing_or_astray_still_give_a_picture(tmp_path: Path, value: float | None) -> None:
    wrong = dict.fromkeys(("mae_deg", "rmse_deg", "turning_mae_deg", "correlation"), value)
    losses = {"training_loss": value, "validation_loss": value}
    run = write_run(tmp_path / "first", 2, **losses, validation=wrong, mean=wrong, zero=wrong)
    predicted = np.full(5, math.nan if value is None else min(value, 1e30))
    assert len(write_run_figures(run, predicted, np.zeros(5))) == 2


# The steering


def test_every_frame_is_a_point_and_the_diagonal_is_drawn() -> None:
    (scatter,) = draw_steering(PREDICTED, RECORDED).axes
    points = np.asarray(scatter.collections[0].get_offsets())
    np.testing.assert_allclose(points, np.column_stack([RECORDED, PREDICTED]))
    (diagonal,) = scatter.get_lines()
    np.testing.assert_array_equal(diagonal.get_xdata(), diagonal.get_ydata())
    off_deg = 25 * math.sqrt(float(np.mean((PREDICTED - RECORDED) ** 2)))
    assert scatter.get_title(loc="left") == f"1,000 frames held out: RMSE {off_deg:.2f}°, correlation 1.00"
    assert "25°" in scatter.get_xlabel()


def test_degrees_are_those_of_the_runs_car() -> None:
    (scatter,) = draw_steering(PREDICTED, RECORDED, 30.0).axes
    assert "30°" in scatter.get_xlabel()


def test_predictions_beyond_the_edge_are_drawn_at_it_and_counted() -> None:
    predicted = PREDICTED.copy()
    predicted[:3] = 7.0, -9.0, 1.2
    (scatter,) = draw_steering(predicted, RECORDED).axes
    assert np.asarray(scatter.collections[0].get_offsets())[:3, 1].tolist() == [1.25, -1.25, 1.2]
    assert "2 beyond" in scatter.get_title(loc="left")
