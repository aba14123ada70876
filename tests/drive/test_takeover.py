"""`--takeover`: the expert drives where the network leaves the lane, and hands the car back."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from drive.control.drive_clock import CourseEvents
from drive.control.takeover import HAND_BACK_S, Takeover
from recorder.server.world import World
from simulator.driving.course import Course
from simulator.driving.expert import Expert
from simulator.roads.track import load_track

STEP_S = 0.04
MIDDLE = World(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0.1, 0.4)


def driven(takeover: Takeover, offsets: list[float], steering: float = 0.1) -> list[tuple[bool, list[str]]]:
    """Whether the expert drives, and what is said, for a car that is seen at these offsets at 25 Hz."""
    seen = []
    for number, offset in enumerate(offsets):
        time_s = number * STEP_S
        events = takeover.update(time_s, replace(MIDDLE, time_s=time_s, offset=offset), steering)
        seen.append((takeover.expert_drives, events))
    return seen


def test_a_network_that_cannot_steer_stays_on_the_road_with_the_expert() -> None:
    """Straight on for ever, on the simulator's own road; without the expert it is off after some seconds."""
    track = load_track("lake")

    def drive(takeover: Takeover | None) -> tuple[int, set[bool], float]:
        course, drivers = Course(track), set()
        expert = Expert(track.line, set_speed_mph=10.0)
        in_flight = (0.0, 0.0)  # as on the wire, the car acts on what was seen one telemetry ago
        while course.time_s < 60:
            steering, throttle = expert.control(course)
            world = replace(
                MIDDLE,
                time_s=course.time_s,
                offset=course.offset,
                interventions=course.interventions,
                expert_steering=steering,
            )
            command = (0.0, throttle)
            if takeover is not None:
                takeover.update(course.time_s, world, 0.0)
                drivers.add(takeover.expert_drives)
                if takeover.expert_drives:
                    command = (steering, throttle)
            course.advance(*in_flight, STEP_S)
            in_flight = command
            if course.intervention_due:
                course.intervene()
        return course.interventions, drivers, course.measures.max_offset

    interventions, drivers, farthest = drive(Takeover())
    assert (interventions, drivers) == (0, {False, True})
    assert 0.5 < farthest < 1.0
    assert drive(None)[0] > 0


def test_the_expert_takes_over_sooner_the_faster_the_car_leaves_the_road() -> None:
    def offset_at_takeover(sideways_per_s: float) -> float:
        offsets = [k * STEP_S * sideways_per_s for k in range(1000)]
        seen = driven(Takeover(), offsets)
        return next(offset for offset, (expert, _) in zip(offsets, seen, strict=True) if expert)

    taken = [offset_at_takeover(speed) for speed in (0.05, 0.3, 1.0)]
    assert taken == sorted(taken, reverse=True)
    assert 0.8 < taken[0] < 1.0
    assert taken[-1] < 0.4
    assert offset_at_takeover(-0.3) == -taken[1]


def test_a_car_that_comes_back_by_itself_is_left_alone() -> None:
    assert not any(expert for expert, _ in driven(Takeover(), [0.9 - 0.02 * k for k in range(45)]))


@pytest.mark.parametrize(
    ("offset", "steering", "hands_back"),
    [(0.1, 0.15, True), (-0.2, 0.0, True), (0.5, 0.1, False), (0.1, 0.6, False), (-0.1, -0.4, False)],
)
def test_it_hands_back_in_the_lane_where_the_network_agrees(
    offset: float, steering: float, hands_back: bool
) -> None:
    takeover = Takeover()
    driven(takeover, [0.95])
    assert takeover.expert_drives
    drivers = [expert for expert, _ in driven(takeover, [offset] * 100, steering)]
    assert drivers[-1] is not hands_back
    if hands_back:  # after the whole while, not before
        assert drivers.index(False) * STEP_S == pytest.approx(HAND_BACK_S, abs=2 * STEP_S)


def test_a_car_that_was_put_back_has_not_driven_to_the_middle() -> None:
    """From 0.8 to the left of it to its right, in one step: no sideways speed that anything follows from."""
    takeover = Takeover()
    takeover.update(0.0, replace(MIDDLE, offset=0.8), 0.0)
    takeover.update(STEP_S, replace(MIDDLE, time_s=STEP_S, offset=-0.1, interventions=1), 0.0)
    assert not takeover.expert_drives


def test_without_a_world_the_network_drives_and_that_is_said_once() -> None:
    takeover = Takeover()
    missing = [
        "nobody can take over: the simulator does not send offset, expert_steering, expert_throttle"
        " (`bc-sim --tell-world` does); in Udacity's, a human takes over by holding a key"
    ]
    times_s = (0.0, 0.9, 1.0, 1.1, 3.0)
    assert [takeover.update(time_s, None, 0.0) for time_s in times_s] == [[], [], missing, [], []]
    takeover.update(3.3, replace(MIDDLE, offset=0.95), 0.0)
    assert takeover.expert_drives
    assert takeover.update(3.4, None, 0.0) == ["the pilot drives again"]
    assert not takeover.expert_drives


def test_a_simulator_without_poses_laps_or_clock_has_an_expert() -> None:
    takeover = Takeover()
    world = World(offset=0.0, expert_steering=0.3, expert_throttle=0.5)
    # half of the half width a second to the left: at 0.7 s from 0.9
    taken = [takeover.update(k / 10, replace(world, offset=k / 20), 0.0) for k in range(13)]
    assert [k for k, printed in enumerate(taken) if printed] == [12]
    assert takeover.expert_drives


def test_what_an_expert_needs_and_is_not_reported_is_named() -> None:
    takeover = Takeover()
    takeover.update(0.0, World(time_s=1.0, offset=0.95), 0.0)
    (printed,) = takeover.update(1.0, World(time_s=2.0, offset=0.95), 0.0)
    assert "does not send expert_steering, expert_throttle (" in printed


def test_laps_and_cars_that_were_put_back_are_events() -> None:
    events = CourseEvents()
    back = "off the road, or stuck: the simulator put the car back"
    worlds = [(0.5, 0), (0.99, 0), (1.01, 0), (0.98, 0), (1.02, 1), (1.5, 1), (2.0, 3), (math.pi, 3)]
    made = [events.update(replace(MIDDLE, laps=laps, interventions=count)) for laps, count in worlds]
    assert made == [[], [], ["lap 1"], [], [back], [], [back, "lap 2"], ["lap 3"]]
