"""What pictures show of a stretch that the numbers leave open: which way the car went, and that it turned."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from recorder import Log, LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log_cli import main
from recorder.rows.odd_stretches import OddStretch, odd_stretches
from recorder.rows.row_quality import States
from recorder.seen.picture_stretches import with_pictures
from tests.helpers.logs import START_NS
from tests.helpers.panorama import RATE_HZ, hand, views, write_drive
from tests.helpers.udacity import call

CYCLE_M = 12.0
"""After so much of the way, another wall is ahead."""


@cache
def wall(way_m: float) -> bytes:
    """A picture of a patterned wall that fills it: nearer, it is larger."""
    number, part = divmod(way_m, CYCLE_M)
    noise = np.random.default_rng(int(number) % 7).uniform(-1, 1, (160, 320)).astype(np.float32)
    pattern = np.clip(128 + 400 * cv2.GaussianBlur(noise, (0, 0), 2), 0, 255).astype(np.uint8)
    about = cv2.getRotationMatrix2D((160, 80), 0, 1.0 + part / CYCLE_M)
    return cv2.imencode(".jpg", cv2.warpAffine(pattern, about, (320, 160)))[1].tobytes()


def rolling(path: Path, direction: float) -> Path:
    """Twenty seconds of driving, a stop, and six seconds in which the car rolls without throttle, this way."""
    parts = [(20.0, 0.5, 12.0, 12.0), (1.0, 0.0, 12.0, 0.0), (6.0, 0.0, 0.0, 10.0)]
    way_m = 0.0
    row = 0
    with LogWriter(path, {"source": "test"}) as writer:
        for seconds, throttle, begin_mph, end_mph in parts:
            for speed_mph in np.linspace(begin_mph, end_mph, round(10 * seconds), endpoint=False).tolist():
                time_ns = START_NS + row * 10**8
                writer.picture("center", time_ns, row, wall(way_m))
                state = VehicleState(steering=0.01 * (row % 7), throttle=throttle, speed_mph=speed_mph)
                writer.vehicle(time_ns, row, state)
                way_m += speed_mph * 0.0447 * (direction if row >= 210 else 1.0)
                row += 1
    return path


def judged(path: Path) -> tuple[list[OddStretch], list[OddStretch]]:
    """By the numbers alone, and by the pictures."""
    with Log(path) as log:
        odd = odd_stretches(States.of(log.vehicle()))
        return odd, with_pictures(log, States.of(log.vehicle()), odd)


def test_pictures_that_shrink_show_that_a_car_rolls_backwards(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = rolling(tmp_path / "a.mcap", -1.0)
    (perhaps,), (shown,) = judged(path)
    assert (perhaps.kind, perhaps.is_sure) == ("backwards", False)
    assert (shown.kind, shown.is_sure, shown.is_shown, shown.is_learnt) == ("backwards", True, True, True)
    assert (shown.first_row, shown.last_row) == (perhaps.first_row, perhaps.last_row)
    assert call(main, "check", path) == 3
    assert "the pictures shrink" in capsys.readouterr().out
    assert call(main, "tag", path, "exclude", "--odd") == 0
    assert capsys.readouterr().out == ""
    assert call(main, "tag", path, "exclude", "--odd", "--look") == 0
    assert capsys.readouterr().out == f"exclude: rows {shown.first_row} to {shown.last_row}\n"


def test_pictures_that_grow_show_that_it_rolls_downhill(tmp_path: Path) -> None:
    odd, shown = judged(rolling(tmp_path / "a.mcap", 1.0))
    assert [stretch.kind for stretch in odd] == ["backwards"]
    assert shown == []


def test_pictures_that_are_flat_leave_it_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flat = cv2.imencode(".jpg", np.full((160, 320), 90, np.uint8))[1].tobytes()
    monkeypatch.setitem(globals(), "wall", lambda way_m: flat)
    odd, shown = judged(rolling(tmp_path / "a.mcap", -1.0))
    assert shown == odd


def test_steering_that_never_changes_while_pictures_turn_is_wrong(tmp_path: Path) -> None:
    def wheel(at_s: np.ndarray) -> np.ndarray:
        return np.asarray(np.where((at_s >= 20) & (at_s < 28), 0.2, hand(at_s)))

    (stuck,), shown = judged(write_drive(tmp_path / "a.mcap", views(600), wheel))
    assert (stuck.kind, stuck.is_sure) == ("stuck_steering", False)
    assert ("stuck_steering", stuck.first_row, True) in [
        (stretch.kind, stretch.first_row, stretch.is_sure) for stretch in shown
    ]
    # where the pictures turn as little, it may be held
    held = views(600)[:200] + [views(600)[200]] * round(8 * RATE_HZ) + views(600)[280:]
    _, shown = judged(write_drive(tmp_path / "b.mcap", held, wheel))
    assert not [stretch for stretch in shown if stretch.kind == "stuck_steering" and stretch.is_sure]
