"""How a session was steered: each figure on rows whose answer is known, and whatever a log may hold."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from recorder.log_cli import main
from recorder.rows.label_plan import plan_labels
from recorder.rows.row_quality import States
from recorder.rows.steering_habits import LagFinding, SteeringLag, steering_habits
from tests.helpers.logs import START_NS, write_log
from tests.helpers.udacity import call


def rows_of(steering: Sequence[float], rate_hz: float = 10.0, time_s: Sequence[float] | None = None) -> States:
    time_ns = START_NS + np.round(
        np.array(time_s if time_s is not None else np.arange(len(steering)) / rate_hz) * 1e9
    ).astype(np.int64)
    every = np.ones(len(steering))
    return States(np.arange(len(steering)), time_ns, np.array(steering, np.float64), every, 0 * every, 9 * every)


def keys(seconds: float, rate_hz: float = 10.0) -> list[float]:
    """Every two seconds a key is pressed: the wheel ramps up in 0.3 s at 3 of full lock a second, and back."""
    at = np.arange(round(seconds * rate_hz)) / rate_hz
    side = np.where((at // 2) % 2 == 0, 1.0, -1.0)
    return list(side * np.clip(np.minimum(at % 2, 0.6 - at % 2) * 3, 0, 1).round(9))


def hand(seconds: float, rate_hz: float = 10.0) -> list[float]:
    """A wheel that is turned all the time."""
    at = np.arange(round(seconds * rate_hz)) / rate_hz
    return list(0.3 * np.sin(at) + 0.2 * np.sin(0.37 * at + 1) + 0.01)


def test_the_figures_of_a_keyboard() -> None:
    habits = steering_habits(rows_of(keys(100)))
    assert (habits.kind, habits.keys, habits.rows) == ("steps", True, 1000)
    assert habits.rate_hz == pytest.approx(10)
    # 0.1 to 0.5 s of each 2 s: five of twenty rows
    assert (habits.zeros, habits.presses) == (0.75, 50)
    assert habits.press_s == pytest.approx(0.5)
    assert (habits.left, habits.right) == (0.125, 0.125)
    assert habits.values == 7  # 0, and three to each side
    assert habits.spread_deg == pytest.approx(25 * np.std(keys(100)))
    assert habits.largest_deg == pytest.approx(25 * 0.9)


def test_a_hand_at_the_wheel_is_smooth() -> None:
    habits = steering_habits(rows_of(hand(100)))
    assert (habits.kind, habits.keys) == ("smooth", False)
    assert habits.ceiling[1] is not None
    assert habits.ceiling[1] > 0.99


def test_a_hand_is_in_time_only_if_pictures_have_reported() -> None:
    habits = steering_habits(rows_of(hand(100)))
    assert plan_labels(habits, None).why == "smooth"
    assert plan_labels(habits, LagFinding(SteeringLag(-0.1, 0.9, 400))).why == "smooth and in time"


def test_presses_whose_lag_nobody_has_measured_are_in_time_and_say_so() -> None:
    habits = steering_habits(rows_of(keys(100)))
    unknown, none = plan_labels(habits, None), plan_labels(habits, LagFinding(None))
    assert (unknown.smooth_s, unknown.shift_s, unknown.why) == (0.5, 0.2, "lag not measured")
    assert (none.smooth_s, none.shift_s, none.why) == (0.5, 0.2, "")


@pytest.mark.parametrize("lag_s", [-0.5, -0.1, 0.3, 0.95])
def test_a_smooth_driver_is_learnt_as_recorded_whatever_the_lag(lag_s: float) -> None:
    """An expert of another simulator was measured to be 0.5 s early, and turned in the same step by its poses."""
    plan = plan_labels(steering_habits(rows_of(hand(100))), LagFinding(SteeringLag(lag_s, 0.9, 400, 0.05)))
    assert (plan.smooth_s, plan.shift_s) == (0, 0)


@pytest.mark.parametrize(
    ("lag_s", "margin_s", "late_s", "why"),
    [
        (-0.1, 0.05, 0.0, ""),
        (-0.5, 0.05, 0.0, "not believed"),
        (0.3, 0.05, 0.4, "0.4 s late"),
        (0.3, 0.25, 0.0, "too unsure"),
        (0.6, 0.05, 0.0, "not believed"),
    ],
)
def test_presses_are_shifted_by_a_lag_that_is_sure_and_can_be(
    lag_s: float, margin_s: float, late_s: float, why: str
) -> None:
    plan = plan_labels(steering_habits(rows_of(keys(100))), LagFinding(SteeringLag(lag_s, 0.9, 400, margin_s)))
    assert plan.shift_s == pytest.approx(0.2 + late_s)
    assert why in plan.why


def test_the_ceiling_is_the_correlation_with_neighbours_of_a_drive() -> None:
    """Beside one that is computed row by row; one row is alone."""
    steering = np.random.default_rng(0).uniform(-1, 1, 200).cumsum() % 1
    time_s = np.sort(np.random.default_rng(1).uniform(0, 25, 200))
    time_s[100:] += 2.5
    time_s[150] += 1000
    time_s[151:] += 2000
    habits = steering_habits(rows_of(list(steering), time_s=list(time_s)))
    gaps = np.concatenate([[0], np.cumsum((np.diff(time_s) > 1) | (np.diff(time_s) < 0))])
    for width_s, ceiling in zip((0.25, 0.5, 1.0), habits.ceiling, strict=True):
        pairs = []
        for i in range(200):
            near = [
                steering[j]
                for j in range(200)
                if j != i and gaps[j] == gaps[i] and abs(time_s[j] - time_s[i]) <= width_s / 2
            ]
            pairs += [(steering[i], np.mean(near))] if near else []
        assert ceiling == pytest.approx(np.corrcoef(np.array(pairs).T)[0, 1], abs=1e-6)


ODD: dict[str, tuple[Callable[[], States], str, str]] = {
    "no rows": (lambda: rows_of([]), "none", "no steering"),
    "never steered": (lambda: rows_of([0.0] * 1000), "none", "no steering"),
    "constant": (lambda: rows_of([0.25] * 1000), "constant", "constant"),
    "seconds only": (lambda: rows_of(keys(5)), "too short", "too short"),
    "one row": (lambda: rows_of([0.3]), "constant", "constant"),
    "tiny": (lambda: rows_of([0.01 * value for value in hand(100)]), "other scale", "scale"),
    "degrees": (lambda: rows_of([25 * value for value in hand(100)]), "other scale", "scale"),
    "degrees, nearly always straight on": (lambda: rows_of([0.0] * 1900 + [8.0] * 100), "other scale", "scale"),
    "no numbers": (lambda: rows_of([math.nan] * 1000), "other scale", "scale"),
    "2 Hz": (lambda: rows_of(keys(200, 2), 2), "steps", "rows a second"),
}


@pytest.mark.parametrize("name", ODD)
def test_a_session_that_shows_nothing_is_named_and_learnt_as_recorded(name: str) -> None:
    make, kind, why = ODD[name]
    habits = steering_habits(make())
    plan = plan_labels(habits, LagFinding(None))
    assert (habits.kind, plan.smooth_s, plan.shift_s) == (kind, 0, 0)
    assert why in plan.why
    json.dumps(asdict(habits), allow_nan=False)


def test_times_that_jump_do_not_count() -> None:
    """Half of the rows lie years later, and then again before all others; some have the same time."""
    time_s = np.arange(1000) / 10
    time_s[300:] += 1e8
    time_s[600:] -= 1.5e8
    time_s[800:] -= 0.1
    habits, plain = (steering_habits(rows_of(keys(100), time_s=at)) for at in (list(time_s), None))
    assert habits.driven_s == pytest.approx(99.6)  # 99.9, and three steps less
    assert (habits.kind, habits.zeros) == (plain.kind, plain.zeros)
    assert habits.rate_hz == pytest.approx(10)


numbers = st.floats() | st.sampled_from([0.0, 1.0, -1.0, math.inf, math.nan])


# In a log


def info_of(path: Path, capsys: pytest.CaptureFixture[str], *flags: str) -> dict[str, Any]:
    assert call(main, "info", path, "--json", *flags) == 0
    reported: dict[str, Any] = json.loads(capsys.readouterr().out)
    return reported


def test_info_reports_how_a_log_was_steered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_log(tmp_path / "a.mcap", keys(70), cameras=("center",))
    reported = info_of(path, capsys)
    expected = json.loads(json.dumps(asdict(steering_habits(rows_of(keys(70))))))
    assert reported["steering"] == expected
    assert (reported["lag"], reported["labels"]) == (None, "mean of 0.5 s, 0.2 s later (lag not measured)")
    assert info_of(path, capsys, "--look")["labels"] == "mean of 0.5 s, 0.2 s later"  # its pictures are none
    assert call(main, "info", path) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "steered: keys; 75% zeros" in printed
    assert "labels: mean of 0.5 s, 0.2 s later" in printed


def test_a_log_that_does_not_say_it_is_asked_for_its_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those of earlier versions, and whatever somebody else has written there."""
    new = info_of(write_log(tmp_path / "new.mcap", keys(70)), capsys)["steering"]
    for number, noted in enumerate(("", "[]", '{"kind": "steps"}', "\\ud800")):
        monkeypatch.setattr("recorder.log.writer.json.dumps", lambda *_, output=noted, **__: output)
        path = write_log(tmp_path / f"old{number}.mcap", keys(70))
        monkeypatch.undo()
        assert info_of(path, capsys)["steering"] == new
