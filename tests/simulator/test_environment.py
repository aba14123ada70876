"""The built-in simulator as a Gymnasium environment, checked by Gymnasium's own checker."""

from __future__ import annotations

import contextlib
import math
import re
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray

import simulator  # noqa: F401 - before Gymnasium makes one: the names must be known all the same
from common.car import CAMERAS
from simulator.driving.simulation import Simulation
from simulator.environment import DrivingEnv, expert
from simulator.roads.track import load_track
from tests.helpers.driving import untrained_run
from tests.helpers.repository import ROOT

LAKE = "simulator:bc/Lake-v0"
LEFT_LOCK = np.array([-1.0, 0.5], np.float32)
NOTHING = np.zeros(2, np.float32)


@pytest.fixture(scope="module")
def lake() -> gymnasium.Env[Any, Any]:
    """One for all that begin with a reset: to build it takes half a second."""
    return gymnasium.make(LAKE)


def drive(
    env: gymnasium.Env[Any, Any], action: NDArray[np.float32] | None = None
) -> tuple[float, int, dict[str, Any]]:
    """An episode to its end by this action, or by the expert's: its return, its steps and the last info."""
    observation, _ = env.reset(options={"start_m": 0.0})
    total, steps = 0.0, 0
    while True:
        sent = expert(env, observation) if action is None else action
        observation, reward, terminated, truncated, info = env.step(sent)
        total, steps = total + float(reward), steps + 1
        if terminated or truncated:
            assert terminated != truncated
            return total, steps, info


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        (LAKE, {"render_mode": "rgb_array"}),
        ("simulator:bc/Mountain-v0", {"cameras": ("center", "right")}),
        ("simulator:bc/Random-v0", {"seed": 7, "rate_hz": 25.0}),
    ],
)
def test_gymnasiums_checker_finds_nothing(name: str, settings: dict[str, Any]) -> None:
    """Its warnings are errors here."""
    env = gymnasium.make(name, **settings)
    check_env(env.unwrapped)
    env.close()


def test_the_reward_is_the_road_driven_and_the_end_a_success() -> None:
    total, _, info = drive(gymnasium.make(LAKE, laps=0.02))
    length_m = load_track("lake").line.length_m
    assert 0.02 * length_m <= total < 0.02 * length_m + 1.0
    assert (info["success"], info["is_success"]) == (True, True)
    assert info["lap"] == pytest.approx(total / length_m)
    assert abs(info["offset"]) < 0.5


def test_leaving_the_road_ends_the_episode_without_success(lake: gymnasium.Env[Any, Any]) -> None:
    _, _, info = drive(lake, LEFT_LOCK)
    assert info["offset"] > 1.0  # on the left
    assert not info["success"]


def test_standing_for_five_seconds_ends_it_too() -> None:
    total, steps, info = drive(gymnasium.make(LAKE, rate_hz=5.0), NOTHING)
    assert (total, steps, info["lap"], info["success"]) == (0.0, 25, 0.0, False)


def test_the_steps_of_an_episode_are_limited() -> None:
    env = gymnasium.make(LAKE, max_episode_steps=2)
    env.reset()
    assert [env.step(NOTHING)[3] for _ in range(2)] == [False, True]
    assert gymnasium.spec("bc/Lake-v0").max_episode_steps == 3000


def test_a_seed_is_a_place_on_the_road_and_options_name_one(lake: gymnasium.Env[Any, Any]) -> None:
    first, again, other = (lake.reset(seed=seed)[0]["center"] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    place = load_track("lake").line.at(100.0)
    lake.reset(options={"start_m": 100.0})
    driving = lake.unwrapped
    assert isinstance(driving, DrivingEnv)
    car = driving.course.vehicle
    assert math.hypot(car.x_m - place.x_m, car.y_m - place.y_m) < 0.01


@pytest.mark.parametrize(("name", "kind"), [("Random", "random"), ("Hairpins", "hairpins")])
def test_the_seed_of_a_drawn_road_names_the_road(name: str, kind: str) -> None:
    roads = [gymnasium.make(f"simulator:bc/{name}-v0", seed=seed) for seed in (7, 7, 8)]
    seven, again, eight = (env.reset(options={"start_m": 0.0})[0]["center"] for env in roads)
    np.testing.assert_array_equal(seven, again)
    assert (seven != eight).any()
    simulation = Simulation(f"{kind}:7")
    np.testing.assert_array_equal(seven, simulation.picture("center")[..., ::-1])  # RGB


def test_it_shows_the_cameras_that_were_asked_for() -> None:
    env = gymnasium.make(LAKE, cameras=("left", "right"), render_mode="rgb_array")
    observation, _ = env.reset(options={"start_m": 50.0})
    simulation = Simulation("lake")
    simulation.course.start(50.0)
    assert set(observation) == {"left", "right", "speed_mph"}
    for camera in CAMERAS[1:]:
        np.testing.assert_array_equal(observation[camera], simulation.picture(camera)[..., ::-1])
    np.testing.assert_array_equal(env.render(), simulation.picture("center")[..., ::-1])


def test_many_at_once_do_what_one_does(lake: gymnasium.Env[Any, Any]) -> None:
    """In this process and in processes of their own, which are not forked: this one has many threads."""
    actions = np.array([[0.0, 1.0], [0.5, 0.2]], np.float32)
    seen = []
    for mode, options in (("sync", {}), ("async", {"context": "spawn"})):
        envs = gymnasium.make_vec(LAKE, num_envs=2, vectorization_mode=mode, vector_kwargs=options)
        with contextlib.closing(envs):
            envs.reset(seed=5)
            seen.append(envs.step(actions))
    for number in range(2):
        lake.reset(seed=5 + number)
        observation, reward, *_, info = lake.step(actions[number])
        for observations, rewards, _, _, infos in seen:
            np.testing.assert_array_equal(observations["center"][number], observation["center"])
            np.testing.assert_array_equal(observations["speed_mph"][number], observation["speed_mph"])
            assert (rewards[number], infos["lap"][number]) == (reward, info["lap"])


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"cameras": ("rear",)}, "center, left, right"),
        ({"cameras": ()}, "center, left, right"),
        ({"cameras": "center"}, "a list of some of center, left, right"),
        ({"cameras": 3}, "^cameras=3: expected a list"),
        ({"laps": math.nan}, "above 0"),
        ({"laps": None}, "^laps=None: expected a number, not NoneType"),
        ({"rate_hz": "10"}, "^rate_hz='10': expected a number, not str"),
        ({"rate_hz": 30.0}, r"^rate_hz=30\.0: it must divide 50"),
        ({"render_mode": "human"}, "rgb_array"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings: dict[str, Any], expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        DrivingEnv("lake", **settings)


def test_a_start_that_is_none_and_a_step_before_a_reset_are_refused() -> None:
    env = DrivingEnv("lake")
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(NOTHING)
    with pytest.raises(ValueError, match="start_m"):
        env.reset(options={"start_m": math.inf})
    with pytest.raises(ValueError, match=r"^start_m=None: expected a number"):
        env.reset(options={"start_m": None})


def test_the_example_of_an_environment_drives(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With a network that has learnt nothing, which soon leaves the road."""
    code = (ROOT / "examples" / "drive_environment.py").read_text(encoding="utf-8")
    assert len(code.splitlines()) <= 30
    untrained_run(cwd / "runs" / "first")
    exec(code, {})
    assert re.fullmatch(r"-?\d+ m in \d+ steps, -?0\.\d+ laps, success: False\n", capsys.readouterr().out)
