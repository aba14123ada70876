"""How a car keeps to its road is named, where its places are recorded and its road is built in."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recorder import Log, LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log.road_places import states_of
from recorder.log.writer import pose_message
from recorder.log_cli import main as bc_log
from recorder.rows.odd_stretches import odd_stretches, off_road_rows
from recorder.upkeep.check import check
from recorder.upkeep.log_info import describe
from simulator.driving.course import Course
from simulator.driving.expert import Expert
from simulator.driving.simulation import Simulation
from tests.helpers.logs import START_NS
from tests.helpers.udacity import call

ROWS = 200
RATE_HZ = 10


def drive(log: Path, steer: bool, **session: str) -> set[int]:
    """The expert on the lake; after five seconds, `steer` turns the wheel to the right until the car has left the
    road, and the expert brings it back without a stop. The rows off the road, as the simulator has them."""
    simulation = Simulation("lake")
    course, track = simulation.course, simulation.track
    expert, off, wanders = Expert(course.line, 15.0), set(), steer
    about = {"source": "simulator", "track": "lake", "track_fingerprint": track.fingerprint(), **session}
    with LogWriter(log, about) as writer:
        for row in range(ROWS):
            steering, throttle = expert.control(course)
            wanders &= not course.off_road
            if wanders and row > 50:
                steering = 0.3
            if course.off_road:
                off.add(row)
            time_ns = START_NS + row * 10**9 // RATE_HZ
            state = VehicleState(
                steering=steering, throttle=max(0.0, throttle), speed_mph=course.vehicle.speed_mph
            )
            writer.vehicle(time_ns, row, state)
            writer.pose(time_ns, row, pose_message(course.pose, time_ns))
            course.advance(steering, throttle, 1 / RATE_HZ)
    return off


def test_a_car_that_comes_back_without_a_stop_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "a.mcap"
    off = drive(log, steer=True)
    assert len(off) > 8
    for odd in (describe(log).odd or [], check(log, look=False).odd):
        (stretch,) = odd
        assert (stretch.kind, stretch.is_sure, stretch.is_learnt) == ("off_road", True, True)
        assert {*range(stretch.first_row, stretch.last_row + 1)} ^ off <= {min(off), max(off)}
    assert f"off the road: rows {stretch.first_row} to {stretch.last_row}, " in str(stretch)
    assert "m beyond the edge)" in str(stretch)
    part = tmp_path / "part.mcap"
    assert call(bc_log, "trim", log, "--to", part, "--rows", 20, ROWS - 1) == 0
    (of_part,) = describe(part).odd or []
    assert (of_part.kind, of_part.rows) == ("off_road", stretch.rows)
    capsys.readouterr()
    assert call(bc_log, "tag", log, "exclude", "--odd") == 0
    assert capsys.readouterr().out == f"exclude: rows {stretch.first_row} to {stretch.last_row}\n"


def test_a_car_on_its_road_or_on_an_unknown_one_is_not_named(tmp_path: Path) -> None:
    assert drive(tmp_path / "on.mcap", steer=False) == set()
    for name, session in (("other", {"track_fingerprint": "f" * 64}), ("none", {"track": "my road"})):
        drive(tmp_path / f"{name}.mcap", steer=True, **session)
    for name in ("on", "other", "none"):
        assert describe(tmp_path / f"{name}.mcap").odd == []
    with Log(tmp_path / "on.mcap") as log:
        states = states_of(log)
    assert states.beyond_m is not None
    half_m = Simulation("lake").track.half_width_m.min()
    assert np.nanmax(states.beyond_m) < -half_m / 2  # the expert keeps to the middle
    nowhere = replace(states, beyond_m=np.full(len(states.row), np.nan))
    assert odd_stretches(nowhere) == []


def test_stretches_that_follow_are_one_and_a_car_put_back_is_none() -> None:
    beyond_m = np.full(100, -1.0)
    beyond_m[[10, *range(20, 30), *range(45, 60), *range(90, 96)]] = 0.5
    off = off_road_rows(beyond_m, np.arange(100) / 10, np.zeros(100, np.int64))
    assert {*np.flatnonzero(off)} == {*range(20, 60), *range(90, 96)}


def written(log: Path, seconds: int, mph: float, steer: Callable[[Course, float], float]) -> int:
    """A drive on the lake, as a person's is recorded: a car that leaves the road is put back on its line. `steer`
    gets the expert's steering. The number of times that it was put back."""
    course = Simulation("lake").course
    expert, put_back = Expert(course.line, mph), 0
    with LogWriter(log, {"source": "simulator", "track": "lake", "driver": "human"}) as writer:
        for row in range(seconds * RATE_HZ):
            steering, throttle = expert.control(course)
            steering = steer(course, steering)
            time_ns = START_NS + row * 10**9 // RATE_HZ + put_back * 1_500_000_000
            speed_mph = course.vehicle.speed_mph
            writer.vehicle(
                time_ns, row, VehicleState(steering=steering, throttle=max(0.0, throttle), speed_mph=speed_mph)
            )
            writer.pose(time_ns, row, pose_message(course.pose, time_ns))
            course.advance(steering, throttle, 1 / RATE_HZ)
            if course.off_road:
                course.intervene()
                put_back += 1
    return put_back


def kinds_in(log: Path) -> dict[str, float]:
    """The seconds of each kind of odd stretch; all are sure."""
    odd = describe(log).odd or []
    assert all(stretch.is_sure and stretch.is_learnt for stretch in odd)
    return {
        kind: sum(one.end_s - one.begin_s for one in odd if one.kind == kind) for kind in {one.kind for one in odd}
    }


@pytest.mark.parametrize("hold_s", [0.6, 1.2])
def test_a_beginner_who_holds_left_and_right_in_turn_weaves_and_leaves_the_road(
    tmp_path: Path, hold_s: float
) -> None:
    side, until_s, wheels = 1.0, 0.0, 0.0

    def hold(course: Course, wanted: float) -> float:
        nonlocal side, until_s, wheels
        if course.time_s >= until_s:
            side = -side if abs(wanted) < 0.8 else math.copysign(1.0, wanted)
            until_s = course.time_s + hold_s
        wheels = float(np.clip(max(wheels * side, 0.0) + 0.3, 0.0, 1.0)) * side  # as a held key moves them
        return wheels

    put_back = written(tmp_path / "a.mcap", 50, 10.0, hold)
    kinds = kinds_in(tmp_path / "a.mcap")
    assert kinds.keys() == ({"weaving", "leaving_the_road"} if put_back else {"weaving"})
    assert sum(kinds.values()) > 40
    assert kinds["weaving"] > 20
    with Log(tmp_path / "a.mcap") as log:
        states = states_of(log)
    without_poses = odd_stretches(replace(states, beyond_m=None, heading_rad=None))
    assert {(stretch.kind, stretch.is_sure) for stretch in without_poses} == {("weaving", False)}


def test_a_wheel_off_the_road_for_long_is_named(tmp_path: Path) -> None:
    def beside(course: Course, wanted: float) -> float:
        if not 10 <= course.time_s < 30:
            return wanted
        return float(
            np.clip(0.2 * (course.offset_m - course.half_width_m + 0.5) + 1.2 * course.heading_error_rad, -1, 1)
        )

    assert written(tmp_path / "a.mcap", 40, 10.0, beside) == 0
    kinds = kinds_in(tmp_path / "a.mcap")
    assert kinds.keys() == {"wheel_off_the_road"}
    assert 10 < kinds["wheel_off_the_road"] < 22
