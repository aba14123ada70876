"""What any simulator may tell beside its telemetry: each member by itself, and what cannot be used is named."""

from __future__ import annotations

import base64
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive.config import DriveConfig
from drive.control.driver import Driver
from model import Pilot, load_pilot
from recorder.server.world import MAX_WORLD_NUMBER, MEMBERS, World, parse_world
from simulator.pose import Pose
from tests.helpers.driving import road_jpeg, untrained_run
from tests.helpers.repository import ROOT

WORLD = World(12.5, -3.0, 4.25, 0.5, 1.5, -0.01, 0.02, -1.25, 0.75, 2, -0.5, 0.25)


def world(**values: Any) -> dict[str, Any]:
    """What the built-in simulator tells, with some values replaced (or left out: ...)."""
    return {name: value for name, value in {**vars(WORLD), **values}.items() if value is not ...}


def used(value: object, decimal: str = ".") -> World | None:
    """What is used of a world with which nothing is wrong."""
    parsed, problems = parse_world(value, decimal)
    assert problems == ()
    return parsed


def problem(value: object, decimal: str = ".") -> str:
    """The one thing that is wrong with it."""
    (text,) = parse_world(value, decimal)[1]
    return text


def test_a_world_is_taken_where_it_is_told() -> None:
    assert used(world()) == WORLD
    assert used(world(more=["of", "it"])) == WORLD
    assert used(None) is None


def test_each_member_may_be_told_by_itself() -> None:
    assert used({"time_s": 1.5}) == World(time_s=1.5)
    assert used({"time_s": 1.5, "laps": None}) == World(time_s=1.5)
    assert used({"laps": 0.5, "interventions": 0}) == World(laps=0.5, interventions=0)
    pose = {name: world()[name] for name in MEMBERS[1:7]}
    parsed = used(pose)
    assert parsed is not None
    assert parsed.pose == Pose(-3.0, 4.25, 0.5, 1.5, -0.01, 0.02)
    assert (parsed.time_s, parsed.expert) == (None, None)
    assert WORLD.expert == (-0.5, 0.25)


@pytest.mark.parametrize("time_s", [-0.96, 0, 1e12, " -3 ", "1e-3"])
def test_a_clock_may_begin_before_0_and_numbers_may_stand_in_strings(time_s: float | str) -> None:
    parsed = used({"time_s": time_s})
    assert parsed == World(time_s=float(time_s))
    assert parsed is not None
    assert type(parsed.time_s) is float


def test_strings_have_the_decimal_point_of_the_telemetry() -> None:
    assert used({"offset": "-0,5"}, decimal=",") == World(offset=-0.5)
    assert used({"offset": -0.5}, decimal=",") == World(offset=-0.5)
    for text, decimal in (("-0,5", "."), ("0.5", ","), ("1,234.5", "."), ("1.234,5", ",")):
        # a half, or five? nobody knows
        assert problem({"offset": text}, decimal) == "offset is a string that is no plain number"


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("time_s", True, "time_s is not a number but true or false"),
        ("laps", [1.0], "laps is not a number but a list"),
        ("offset", "", "offset is a string that is no plain number"),
        ("offset", "٠", "offset is a string that is no plain number"),
        ("time_s", math.nan, "time_s is beyond 1e+12, or no number"),
        ("laps", 10**400, "laps is beyond 1e+09, or no number"),
        ("laps", "9e99", "laps is beyond 1e+09, or no number"),
        ("offset", 2 * MAX_WORLD_NUMBER, "offset is beyond 1e+09, or no number"),
        ("interventions", -1, "interventions is not a whole number from 0 on"),
        ("interventions", 0.5, "interventions is not a whole number from 0 on"),
    ],
)
def test_what_cannot_be_used_is_named_and_the_rest_is_used(name: str, value: object, said: str) -> None:
    parsed, problems = parse_world(world(**{name: value}))
    assert problems == (said,)
    assert parsed == World(**world(**{name: None}))


@pytest.mark.parametrize("value", [{}, {"time": 3}])
def test_names_that_nobody_knows_are_told_those_that_are(value: object) -> None:
    assert parse_world(value)[0] is None
    assert all(name in problem(value) for name in MEMBERS)


SCALARS = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.text("0123456789.,-eE '", max_size=12)
)
JSON = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3)
)


@given(
    JSON | st.fixed_dictionaries({}, optional={name: SCALARS | st.just(value) for name, value in world().items()}),
    st.sampled_from(".,/\u066b"),
)
def test_any_world_is_one_of_finite_numbers(value: object, decimal: str) -> None:
    parsed, problems = parse_world(value, decimal)
    assert parsed is not None or problems or value is None or isinstance(value, dict)
    if parsed is None:
        return
    numbers = [number for number in vars(parsed).values() if number is not None]
    assert numbers
    assert all(math.isfinite(number) for number in numbers)
    assert (parsed.pose is None) == (parsed.x_m is None)
    assert all(-1 <= command <= 1 for command in parsed.expert or ())


# While it is driven


@pytest.fixture(scope="module")
def pilot(tmp_path_factory: pytest.TempPathFactory) -> Pilot:
    return load_pilot(untrained_run(tmp_path_factory.mktemp("runs") / "run"))


def telemetry(**more: object) -> dict[str, Any]:
    return {
        "steering_angle": "0.0000",
        "throttle": "0.1000",
        "speed": "9.0000",
        "image": base64.b64encode(road_jpeg(1)).decode(),
        **more,
    }


def test_what_is_wrong_with_a_world_is_named_once(pilot: Pilot) -> None:
    driver = Driver(pilot, DriveConfig())
    worlds = [{"time_s": k / 10, "laps": "half", **({"offset": True} if k > 2 else {})} for k in range(6)]
    said = [driver.decide(telemetry(world=value), 0.0, now_s=0.0).events for value in worlds]
    laps = "the simulator's world is not used whole: laps is a string that is no plain number"
    offset = "the simulator's world is not used whole: offset is not a number but true or false"
    assert said == [(laps,), (), (), (offset,), (), ()]


def test_a_simulator_that_tells_its_time_alone_is_driven_by_it(pilot: Pilot) -> None:
    """Steering that is smoothed over a second follows the simulator's seconds, whatever the clock shows."""

    def steered(seconds_of_the_clock: float) -> list[float]:
        driver = Driver(pilot, DriveConfig(smooth_s=1.0))
        return [
            driver.decide(telemetry(world={"time_s": k / 10}), 0.0, now_s=k * seconds_of_the_clock).steering
            for k in range(5)
        ]

    assert steered(0.001) == steered(7.0)
    assert len({*steered(7.0)}) == 5


def test_the_docs_name_every_member() -> None:
    page = (ROOT / "docs" / "simulator.md").read_text(encoding="utf-8")
    assert [name for name in MEMBERS if f"`{name}`" not in page] == []
