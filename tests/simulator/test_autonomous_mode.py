"""The built-in simulator tells its world, if asked: checked against a second one that goes the same way."""

from __future__ import annotations

import base64
import itertools
import json
import math
import threading
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import pytest

from recorder.server.telemetry import Telemetry, parse_telemetry
from recorder.server.world import World
from simulator.cli import main
from simulator.driving.course import Course
from simulator.driving.expert import Expert
from simulator.driving.simulation import Simulation
from simulator.protocol.autonomous_mode import AutonomousDrive, drive_autonomously
from simulator.protocol.client import SimulatorClient
from simulator.roads.track import load_track
from tests.helpers.bare_server import OPEN, BareServer, Wire, steer
from tests.helpers.udacity import call

SET_SPEED_MPH = 12.0
RATE_HZ = 10.0
LAKE = Simulation("lake")  # half a second to build; every drive starts it again

Drive = Callable[[Telemetry], tuple[float, float]]


def serving(drive: Drive, heard: list[dict[str, Any]]) -> Callable[[Wire], None]:
    """Answers each telemetry by steering and throttle, and keeps its fields."""

    def serve(wire: Wire) -> None:
        wire.say(OPEN)
        while True:
            heard.append(json.loads(wire.hear_telemetry()[2:])[1])
            steering, throttle = drive(parse_telemetry(heard[-1]))
            wire.say(steer(repr(steering), repr(throttle)))

    return serve


def driven(
    drive: Drive, laps: float, rate_hz: float = RATE_HZ, **options: Any
) -> tuple[list[dict[str, Any]], AutonomousDrive]:
    """The telemetries of a drive of the built-in simulator, and its own book."""
    heard: list[dict[str, Any]] = []
    with BareServer(serving(drive, heard)) as server:
        expert = Expert(LAKE.track.line, SET_SPEED_MPH)
        client = SimulatorClient(port=server.port)
        book = drive_autonomously(LAKE, client, laps=laps, rate_hz=rate_hz, expert=expert, **options)
    return heard, book


def world_of(reported: Telemetry) -> Any:
    """A `World` of which nothing is None: the built-in simulator tells all of it."""
    assert reported.world is not None
    assert None not in vars(reported.world).values()
    return reported.world


def as_the_expert(reported: Telemetry) -> tuple[float, float]:
    steering, throttle = world_of(reported).expert
    return steering, throttle


def weaving(reported: Telemetry) -> tuple[float, float]:
    """Not where the expert would go."""
    return 0.1 * math.sin(2 * world_of(reported).time_s), 0.8


def to_the_left_until(offset: float) -> Drive:
    """Off to the left with the wheel turned, then as the expert, until the end."""
    taken_over = threading.Event()

    def drive(reported: Telemetry) -> tuple[float, float]:
        if world_of(reported).offset > offset:
            taken_over.set()
        return as_the_expert(reported) if taken_over.is_set() else (-0.3, 0.5)

    return drive


def test_the_world_is_that_of_the_moment_whose_picture_is_reported() -> None:
    heard, _ = driven(weaving, laps=0.015)
    reported = [parse_telemetry(fields) for fields in heard]
    other = Simulation("lake")  # driven by the same commands: each takes hold after its telemetry was answered
    expert = Expert(other.track.line, SET_SPEED_MPH)
    assert len(reported) > 20
    for number, moment in enumerate(reported):
        if number >= 2:  # two telemetries are told before the first answer
            steering, throttle = weaving(reported[number - 2])
            other.course.advance(steering, throttle, 1 / RATE_HZ)
        steering, throttle = expert.control(other.course)
        assert moment.world == World(
            time_s=other.course.time_s,
            **asdict(other.course.pose),
            offset=other.course.offset,
            laps=other.course.laps,
            interventions=0,
            expert_steering=steering,
            expert_throttle=throttle,
        )
        assert moment.picture == other.jpeg()
        assert world_of(moment).time_s == pytest.approx(max(0, number - 1) / RATE_HZ)
    assert len({moment.world for moment in reported}) == len(reported) - 1  # the first two tell the same moment


def test_every_value_is_a_json_number_and_the_rest_is_as_the_real_one() -> None:
    heard, _ = driven(weaving, laps=0.005)
    for fields in heard:
        world = fields.pop("world")
        assert all(isinstance(value, int | float) and not isinstance(value, bool) for value in world.values())
        assert isinstance(world["interventions"], int)
        assert list(fields) == ["steering_angle", "throttle", "speed", "image"]
        assert all(isinstance(value, str) for value in fields.values())


def test_an_expert_who_takes_over_off_the_road_brings_the_car_back() -> None:
    heard, book = driven(to_the_left_until(0.9), laps=0.04, rate_hz=5.0, leave_off_road=True)
    worlds = [world_of(parse_telemetry(fields)) for fields in heard]
    assert max(world.offset for world in worlds) > 1.1  # what was on its way when he took over
    assert abs(worlds[-1].offset) < 0.3
    assert book.measures.interventions == worlds[-1].interventions == 0
    assert all(abs(b.x_m - a.x_m) + abs(b.y_m - a.y_m) < 3 for a, b in itertools.pairwise(worlds))  # no jump


def test_without_that_it_is_put_back_and_counted_before_he_can() -> None:
    heard, book = driven(to_the_left_until(0.9), laps=0.015, rate_hz=5.0)
    worlds = [world_of(parse_telemetry(fields)) for fields in heard]
    assert max(world.offset for world in worlds) <= 1
    assert book.measures.interventions == worlds[-1].interventions == 1


@pytest.mark.parametrize(("leave_off_road", "patience_s"), [(False, 5.0), (True, 15.0)])
def test_a_car_that_does_not_get_on_is_put_back_all_the_same(leave_off_road: bool, patience_s: float) -> None:
    def drive(reported: Telemetry) -> tuple[float, float]:
        return as_the_expert(reported) if world_of(reported).interventions else (0.0, 0.0)

    heard, book = driven(drive, laps=0.002, rate_hz=2.0, leave_off_road=leave_off_road)
    worlds = [world_of(parse_telemetry(fields)) for fields in heard]
    put_back_s = next(world.time_s for world in worlds if world.interventions)
    assert put_back_s == pytest.approx(patience_s, abs=0.5)
    assert book.measures.interventions == 1


def test_a_command_can_ask_for_the_car_to_be_put_back_once() -> None:
    heard: list[dict[str, Any]] = []

    def serve(wire: Wire) -> None:
        wire.say(OPEN)
        while True:
            heard.append(json.loads(wire.hear_telemetry()[2:])[1])
            name, fields = json.loads(steer("-0.3", "0.5")[2:])
            asks = {"put_back": "true"} if len(heard) == 20 else {}
            wire.say("42" + json.dumps([name, fields | asks]))

    with BareServer(serve) as server:
        client, expert = SimulatorClient(port=server.port), Expert(LAKE.track.line, SET_SPEED_MPH)
        drive_autonomously(LAKE, client, laps=0.01, rate_hz=RATE_HZ, expert=expert, leave_off_road=True)
    worlds = [world_of(parse_telemetry(fields)) for fields in heard]
    assert [world.interventions for world in worlds] == [0] * 21 + [1] * (len(worlds) - 21)
    assert worlds[20].offset > 0.1
    assert (worlds[21].offset, parse_telemetry(heard[21]).speed_mph) == (pytest.approx(0, abs=1e-6), 0)


def test_a_car_that_never_gets_on_is_given_up_and_the_drive_ends() -> None:
    _, book = driven(lambda reported: (0.0, 0.0), laps=1.0, rate_hz=2.0)
    assert book.gave_up
    assert book.measures.elapsed_s == pytest.approx(60, abs=1)
    assert (book.whole_laps, book.measures.interventions) == (0, 12)  # put back every 5 s


def test_an_expert_of_25_hz_one_step_late_keeps_the_road() -> None:
    """What a takeover relies on, at the rates and speeds in use; without pictures, which he does not look at."""
    for mph in (10.0, 30.0):
        course = Course(load_track("mountain"))
        expert = Expert(course.line, mph)
        late = expert.control(course)
        while course.laps < 0.5:
            now = expert.control(course)
            course.advance(*late, 1 / 25)
            late = now
        assert course.measures.max_offset < 0.3


def first_telemetries(*flags: str) -> list[dict[str, Any]]:
    """What `bc-sim` tells with these flags."""
    heard: list[dict[str, Any]] = []
    with BareServer(serving(lambda reported: (0.0, 1.0), heard)) as server:
        line = ("--port", str(server.port), "--laps", "0.0005", "--rate", "10")
        assert call(main, *line, *flags) == 0
    return heard


def test_bc_sim_shows_the_world_only_if_it_is_asked_to(capsys: pytest.CaptureFixture[str]) -> None:
    assert not any("world" in fields for fields in first_telemetries())
    slow, fast = (first_telemetries("--tell-world", "--expert-speed", mph) for mph in ("5", "25"))
    # at rest both want to be faster; once rolling, the slow one less so
    assert slow[-1]["world"]["expert_throttle"] < fast[-1]["world"]["expert_throttle"] <= 1
    assert base64.b64decode(slow[-1]["image"]).startswith(b"\xff\xd8")
    assert "0.00 laps" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (("--tell-world", "--expert-speed", "0"), "--expert-speed 0"),
        (("--tell-world", "--expert-speed", "nan"), "--expert-speed nan"),
        (("--tell-world", "--replay", "."), "--tell-world"),
        (("--start", "-1"), "--start -1"),
        (("--rate", "7"), "--rate 7"),
        (("--laps", "nan"), "--laps nan"),
        (("--port", "99999"), "--port 99999"),
        (("--wait", "nan"), "--wait nan"),
        (("--replay", ".", "--count", "0"), "--count 0"),
        (("--count", "3"), "--count 3: only with --replay"),
        (("--replay", ".", "--laps", "2", "--real-time"), "--laps, --real-time"),
    ],
)
def test_what_makes_no_sense_is_one_line_that_names_the_flag(
    flags: tuple[str, ...], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(main, "--port", "1", *flags) == 2
    reported = capsys.readouterr()
    assert f"bc-sim: {named}" in reported.err
    assert "Traceback" not in reported.err
    assert reported.out == ""
