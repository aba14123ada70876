"""`bc-record gym`: an expert in a Gymnasium environment becomes a session like any other."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from recorder.cli import main as bc_record
from recorder.log.reader import Log
from recorder.log_cli import main as bc_log
from recorder.upkeep.check import check
from tests.helpers.driving import one_line_in
from tests.helpers.repository import ROOT
from tests.helpers.toy_environment import RATE_HZ, STEPS, bar_file, place_in
from tests.helpers.udacity import call

BARE = "tests.helpers.toy_environment:toy/Bar-v0"
CENTRE = ["--expert", "tests.helpers.toy_environment:centre"]


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def states(name: str) -> dict[str, Any]:
    """The rows of a session, by column."""
    with Log(f"sessions/{name}.mcap") as log:
        columns: dict[str, Any] = log.vehicle().to_pydict()
        return columns


def places(name: str) -> list[float]:
    """Where the bar is in each recorded picture."""
    with Log(f"sessions/{name}.mcap") as log:
        jpegs = [log.picture(row) for row in range(len(log.vehicle()))]
    decoded = (cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR) for jpeg in jpegs)
    return [place_in(np.asarray(picture, np.uint8)) for picture in decoded]


def test_each_step_is_a_row_of_what_was_seen_and_what_the_expert_wanted(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert call(bc_record, "gym", bar_file(speed="2.237*speed"), "bar", *CENTRE, "--episodes", 2) == 0
    assert "60 rows, 60 pictures" in capsys.readouterr().out
    vehicle = states("bar")
    pixel = 2.0 / 55  # of the bar's place
    np.testing.assert_allclose(vehicle["steering"], [-0.5 * place for place in places("bar")], atol=0.5 * pixel)
    assert set(vehicle["throttle"]) == {0.25}
    assert set(vehicle["brake"]) == {0.0}
    np.testing.assert_allclose(vehicle["speed_mph"], 4.0 * 3600 / 1609.344, rtol=1e-3)
    steps_s = np.diff(np.array(vehicle["log_time_ns"], np.float64)) / 1e9
    np.testing.assert_allclose(np.delete(steps_s, STEPS - 1), 1 / RATE_HZ, rtol=1e-4)
    assert steps_s[STEPS - 1] > 1.0  # episodes are drives of their own
    with Log("sessions/bar.mcap") as log:
        assert log.metadata["simulator"] == "tests.helpers.toy_environment:toy/Bar-v0"
        assert log.metadata["driver"] == "tests.helpers.toy_environment:centre"


def test_what_the_environment_does_not_show_stays_empty() -> None:
    environment = bar_file(action="steering,0.5", args={"observation": "picture"})
    assert call(bc_record, "gym", environment, "bar", *CENTRE) == 0
    vehicle = states("bar")
    assert all(math.isnan(speed) for speed in vehicle["speed_mph"])
    assert set(vehicle["throttle"]) == set(vehicle["brake"]) == {0.0}


def test_a_seed_repeats_its_rows_and_the_next_episode_has_the_next_seed() -> None:
    for name, seed, episodes in (("two", 4, 2), ("first", 4, 1), ("second", 5, 1)):
        assert call(bc_record, "gym", bar_file(), name, *CENTRE, "--seed", seed, "--episodes", episodes) == 0
    two, first, second = (states(name)["steering"] for name in ("two", "first", "second"))
    assert two == first + second
    checked = check(Path("sessions/two.mcap"), look=False)
    assert checked.meant_gaps == [f"before row {len(first)}"]  # between the episodes
    assert "gaps in time" not in {finding.kind for finding in checked.findings}


def test_the_hand_wanders_and_the_experts_steering_is_recorded() -> None:
    assert call(bc_record, "gym", bar_file(), "calm", *CENTRE) == 0
    assert call(bc_record, "gym", bar_file(), "wanders", *CENTRE, "--wander", 0.8) == 0
    seen = places("wanders")
    assert np.abs(np.subtract(seen, places("calm"))).max() > 0.1
    np.testing.assert_allclose(states("wanders")["steering"], [-0.5 * place for place in seen], atol=1 / 55)


def test_what_an_expert_wanted_is_learnt_as_it_is_however_he_steers(capsys: pytest.CaptureFixture[str]) -> None:
    """Steering in steps is smoothed and shifted where people press keys; but he is never late."""
    expert = ("--expert", "tests.helpers.toy_environment:to_and_fro")
    assert call(bc_record, "gym", bar_file(), "steps", *expert, "--episodes", 45, "--rate", 5) == 0
    capsys.readouterr()
    assert call(bc_log, "info", "sessions/steps.mcap", "--json") == 0
    output = json.loads(capsys.readouterr().out)
    assert output["steering"]["kind"] == "steps"
    assert output["labels"] == "as recorded (driven by an expert)"


def test_left_may_be_positive_and_scales_may_differ() -> None:
    assert call(bc_record, "gym", bar_file(), "bar", *CENTRE) == 0
    assert call(bc_record, "gym", bar_file(action="-2*steering,0.5*throttle"), "other", *CENTRE) == 0
    one, other = states("bar"), states("other")
    np.testing.assert_allclose(other["steering"], np.array(one["steering"]) / -2.0)
    assert set(other["throttle"]) == {0.5}


@pytest.mark.needs("box2d")
def test_car_racing_is_recorded(capsys: pytest.CaptureFixture[str]) -> None:
    expert = ROOT / "examples" / "car_racing_expert.py"
    Path("race.toml").write_text((ROOT / "examples/car_racing.toml").read_text() + "args.max_episode_steps = 20")
    assert call(bc_record, "gym", "race.toml", "race", "--expert", f"{expert}:drive") == 0
    printed = capsys.readouterr()
    assert "20 rows, 20 pictures" in printed.out
    assert printed.err.startswith("1 episode driven to the end, with a reward of ")
    with Log("sessions/race.mcap") as log:
        picture = cv2.imdecode(np.frombuffer(log.picture(19), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (96, 96, 3)
    assert max(states("race")["throttle"]) > 0.1
    assert call(bc_log, "check", "sessions/race.mcap") == 0


@pytest.mark.parametrize(
    ("arguments", "code", "expected"),
    [
        (["Nowhere-v0", *CENTRE], 1, "Nowhere-v0: cannot be made (NameNotFound"),
        (["no_such_module:X-v0", *CENTRE], 1, "No module named 'no_such_module'"),
        ([{"args": {"wheels": 3}}, *CENTRE], 1, "unexpected keyword argument 'wheels'"),
        ([{"args": [1]}, *CENTRE], 2, "Expected `object`, got `array`"),
        ([{"wheels": 3}, *CENTRE], 2, "unknown settings: wheels"),
        (["missing.toml", *CENTRE], 2, "missing.toml: no such file"),
        ([{"args": {"observation": "numbers"}}, *CENTRE], 1, "no camera picture in its observation"),
        ([{"args": {"observation": "two"}}, *CENTRE], 1, "Give its key as picture, one of front, rear"),
        ([{"picture": "rear"}, *CENTRE], 1, "it has: pixels.front"),
        ([{"args": {"action": "discrete"}}, *CENTRE], 1, "its actions are Discrete(3)"),
        ([BARE, *CENTRE], 1, "has 2 numbers"),
        ([{"action": "throttle,brake"}, *CENTRE], 2, "one number of the action has to be the steering"),
        (
            [{"action": "steering,gas"}, *CENTRE],
            2,
            "'gas': expected a number, or steering, throttle, brake, pedals",
        ),
        ([{"action": "0*steering,throttle"}, *CENTRE], 2, "a factor other than 0"),
        ([{"args": {"fps": 0}}, *CENTRE], 1, "give its steps a second as rate_hz"),
        ([{}, *CENTRE, "--rate", "15"], 1, "must divide the environment's 20 steps a second"),
        ([{"speed": "velocity"}, *CENTRE], 1, "there is: pixels, speed"),
        (
            [{"speed": "pace", "args": {"observation": "worded"}}, *CENTRE],
            1,
            "speed pace: no such number",
        ),
        ([{}, *CENTRE, "--episodes", "0"], 2, "--episodes 0"),
        ([{}, *CENTRE, "--wander", "nan"], 2, "--wander nan"),
        ([{}, *CENTRE, "--track", "mountain"], 2, "--track"),
        ([{}], 2, "by --expert MODULE:FUNCTION"),
        ([{}, "--expert", "tests.helpers.toy_environment"], 2, "expected module:function"),
        ([{}, "--expert", "no_such:drive"], 1, "no_such cannot be imported (ModuleNotFoundError"),
        ([{}, "--expert", "missing.py:drive"], 1, "no file missing.py"),
        ([{}, "--expert", "tests.helpers.toy_environment:center"], 1, "did you mean centre?"),
        (
            [{}, "--expert", "tests.helpers.toy_environment:too_many"],
            1,
            "shape (3,); expected an action of 2 numbers",
        ),
        ([{}, "--expert", "tests.helpers.toy_environment:nothing"], 1, "; expected an action of 2 numbers"),
        (
            [{}, "--expert", "tests.helpers.toy_environment:failing"],
            1,
            "failed (ZeroDivisionError: the track has no width)",
        ),
    ],
)
def test_what_cannot_be_recorded_is_said_in_one_line(
    arguments: list[Any], code: int, expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    environment, *flags = arguments
    path = bar_file(**environment) if isinstance(environment, dict) else environment
    assert call(bc_record, "gym", path, "bar", *flags) == code
    line = one_line_in(capsys)
    assert expected in line
    assert not Path("sessions").exists()


def test_what_was_recorded_before_an_expert_gave_nan_is_kept(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_record, "gym", bar_file(), "bar", "--expert", "tests.helpers.toy_environment:nan_later") == 1
    assert "at step 7 it gave [nan, 0.0]: expected finite numbers" in one_line_in(capsys)
    assert states("bar")["steering"] == [pytest.approx(0.1)] * 7
