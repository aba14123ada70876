"""The lag of steering, measured in pictures of a panorama that turns as the wheel did."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from recorder import Log
from recorder.log.known_lag import measure_lag
from recorder.log_cli import main as bc_log
from recorder.pictures.picture_size import decode_picture
from recorder.rows.row_quality import States
from recorder.rows.steering_habits import SteeringLag
from tests.helpers.panorama import RATE_HZ, Seconds, hand, views, write_drive
from tests.helpers.udacity import call

ROWS = 420


def lag_of(path: Path) -> SteeringLag | None:
    with Log(path) as log:
        return measure_lag(log, States.of(log.vehicle()))


@pytest.mark.parametrize("late_s", [-2.0, -0.5, -0.2, 0.0, 0.1, 0.3, 0.6, 2.0])
def test_steering_that_was_recorded_late_or_early_is_found_out(late_s: float, tmp_path: Path) -> None:
    lag = lag_of(write_drive(tmp_path / "a.mcap", views(ROWS), lambda at_s: hand(at_s - late_s)))
    assert lag is not None
    assert lag.lag_s == pytest.approx(late_s, abs=0.051)
    assert lag.correlation > 0.9
    assert lag.pictures == ROWS


@pytest.mark.parametrize("driver", ["", "expert"])
@pytest.mark.parametrize(
    ("late_s", "words"),
    [
        (1.0, "1.1 s late; `bc-index --label-shift 1.1`"),
        (-1.2, "1.1 s early; `bc-index --label-shift -1.1`"),
        (-0.3, "nothing wrong"),
        (0.3, "nothing wrong"),
    ],
)
def test_a_check_names_steering_that_is_late_or_early(
    late_s: float, words: str, driver: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_drive(tmp_path / "a.mcap", views(700), lambda at_s: hand(at_s - late_s), driver=driver)
    assert call(bc_log, "check", log) == (0 if words == "nothing wrong" else 3)
    assert words in capsys.readouterr().out


def _recorded(wheel: Seconds, at_s: Seconds) -> Seconds:
    return wheel


def test_a_noisy_lag_has_a_wider_margin_that_holds_the_true_one(tmp_path: Path) -> None:
    calm = lag_of(write_drive(tmp_path / "calm.mcap", views(ROWS)))
    assert calm is not None
    assert calm.margin_s == 0.05  # lags are tried so far apart
    for seed in range(5):
        wheel = hand(np.arange(ROWS) / RATE_HZ - 0.2) + np.random.default_rng(seed).normal(0, 0.2, ROWS)
        noisy = lag_of(write_drive(tmp_path / f"{seed}.mcap", views(ROWS), partial(_recorded, wheel)))
        assert noisy is not None
        assert noisy.margin_s is not None
        assert noisy.margin_s > calm.margin_s
        assert abs(noisy.lag_s - 0.2) <= noisy.margin_s + 1e-9


def test_pictures_that_turn_the_other_way_are_reported(tmp_path: Path) -> None:
    lag = lag_of(write_drive(tmp_path / "a.mcap", views(ROWS), lambda at_s: -hand(at_s - 0.2)))
    assert lag is not None
    assert lag.lag_s == pytest.approx(0.2, abs=0.051)
    assert lag.correlation < -0.9


def test_what_shows_nothing_is_no_lag(tmp_path: Path) -> None:
    pictures = views(ROWS)
    assert lag_of(write_drive(tmp_path / "short.mcap", pictures[:150])) is None
    assert lag_of(write_drive(tmp_path / "slow.mcap", pictures, speed_mph=2.0)) is None
    assert lag_of(write_drive(tmp_path / "still.mcap", pictures[:1] * ROWS)) is None
    assert lag_of(write_drive(tmp_path / "broken.mcap", [b"no picture"] * ROWS)) is None
    assert lag_of(write_drive(tmp_path / "straight.mcap", pictures, np.zeros_like)) is None
    someone_else = np.random.default_rng(3).uniform(-1, 1, ROWS)
    assert lag_of(write_drive(tmp_path / "other.mcap", pictures, lambda at_s: someone_else)) is None


@pytest.mark.parametrize("columns", [64, 80, 160])
def test_a_small_camera_shows_the_lag(columns: int, tmp_path: Path) -> None:
    size = (columns, columns // 2)
    decoded = [decode_picture(view, cv2.IMREAD_GRAYSCALE) for view in views(ROWS)]
    small = [cv2.resize(view, size, interpolation=cv2.INTER_AREA) for view in decoded if view is not None]
    lag = lag_of(write_drive(tmp_path / "a.mcap", [cv2.imencode(".jpg", view)[1].tobytes() for view in small]))
    assert lag is not None
    assert lag.lag_s == pytest.approx(0, abs=0.051)
    assert lag.correlation > 0.9
