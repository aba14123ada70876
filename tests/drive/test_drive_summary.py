"""What is said of a drive at its end: distances, autonomy, and percentiles that numpy gives too."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drive.control.driver import Decision
from drive.log.drive_summary import DriveSummary
from drive.log.summary_lines import LiveStatus, summary_lines
from recorder.server.telemetry import Telemetry
from recorder.server.world import World
from simulator.driving.course import Course
from simulator.driving.expert import Expert
from simulator.roads.track import load_track

WORLD = World(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0.0, 0.0)
MPH = 0.44704  # m/s, by definition of the mile
BAD = Decision(steering=0.0, throttle=0.0, problem="not an object but a list", kind="not an object")


def decided(speed_mph: float = 10.0, world: World | None = None, **changed: Any) -> Decision:
    telemetry = Telemetry(0.0, 0.5, speed_mph, b"jpeg", world=world)
    decision = Decision(
        steering=0.03,
        throttle=0.5,
        driver="pilot",
        telemetry=telemetry,
        speed_mph=speed_mph,
        parse_ms=0.1,
        decode_ms=0.2,
        network_ms=1.0,
        set_speed_mph=10.0,
    )
    return replace(decision, **changed)


def test_nothing_is_rolled_while_no_speed_is_reported() -> None:
    summary = DriveSummary()
    for i in range(3):
        summary.decision(decided(), 2.0, now_s=i / 10)
    driven_m = summary.distance_m
    for i in range(60):
        summary.manual(0.1, now_s=0.3 + i / 10)
    assert summary.distance_m == driven_m == pytest.approx(10 * 0.44704 * 0.2)
    assert summary.mean_speed_mph == pytest.approx(10)
    assert summary.elapsed_s == pytest.approx(6.2)


def test_what_another_simulator_drove_before_is_not_counted() -> None:
    summary = DriveSummary()
    for laps, interventions in ((0.5, 0), (3.5, 7)):  # the second has driven already
        summary.connected()
        for i in range(10):
            world = replace(WORLD, time_s=laps * 100 + i / 25, laps=laps + i / 1000, interventions=interventions)
            summary.decision(decided(world=world), 2.0, now_s=i / 25)
    assert summary.laps == pytest.approx(0.018)
    assert summary.interventions == 0


def test_laps_are_reported_only_if_every_frame_has_them() -> None:
    summary = DriveSummary()
    for i in range(3):
        summary.decision(decided(), 2.0, now_s=i / 25)
    summary.connected()  # another simulator takes its place, and tells
    for i in range(25):
        summary.decision(decided(world=replace(WORLD, time_s=i / 25, laps=i / 100)), 2.0, now_s=1 + i / 25)
    assert summary.laps is None
    assert "laps" not in summary.as_metadata()
    distance, autonomy, *_ = summary_lines(summary)
    assert "laps" not in distance
    assert autonomy == "autonomy 100.0 %, 0 interventions (for 3 frames unknown whether the car left the road)"
    assert "laps" not in LiveStatus(summary).line(2.0)


# How far, how long


def test_a_pause_is_no_driving() -> None:
    summary = DriveSummary()
    for now_s in (0.0, 0.5, 1.0, 301.0, 301.5):  # five minutes in the simulator's menu
        summary.decision(decided(), 2.0, now_s)
    assert summary.elapsed_s == pytest.approx(1.5)
    assert summary.distance_m == pytest.approx(10 * MPH * 1.5)


def test_a_simulated_clock_that_jumps_adds_no_years_and_no_distance() -> None:
    summary = DriveSummary()
    for i in range(40):
        summary.decision(decided(world=replace(WORLD, time_s=1e9 * (i % 2))), 2.0, now_s=i / 25)
    assert summary.elapsed_s < 2
    assert summary.distance_m < 10


@pytest.mark.parametrize("step_s", [0.0, -1.0])
def test_a_simulated_clock_that_does_not_advance_is_not_used(step_s: float) -> None:
    summary = DriveSummary()
    for i in range(41):
        summary.decision(decided(world=World(time_s=7 + i * step_s)), 2.0, now_s=1000 + i / 20)
    assert summary.elapsed_s == summary.driven_s == pytest.approx(2.0)
    assert summary.clock == "computer"
    assert summary.distance_m == pytest.approx(10 * MPH * 2)


@pytest.mark.parametrize("clocks_s", [0.004, 0.4])
def test_a_simulator_that_sends_only_its_time_is_measured_by_it(clocks_s: float) -> None:
    """Faster or slower than the clock: 20 mph for 60 of its seconds are a third of a mile."""
    summary = DriveSummary()
    for i in range(1501):
        summary.decision(decided(20.0, World(time_s=i / 25)), 2.0, now_s=i * clocks_s)
    assert summary.distance_m == pytest.approx(1609.344 / 3, rel=1e-3)
    assert summary.mean_speed_mph == pytest.approx(20.0)
    summary.manual(2.0, now_s=1500 * clocks_s + 0.5)  # 0.5 s of ours, at 20 mph nobody knows
    assert summary.autonomy_percent == pytest.approx(100 * (1 - 6 / 60.5))
    assert summary.laps is None
    assert "this simulator does not report when the car leaves the road" in " ".join(summary_lines(summary))


def test_a_lap_of_the_expert_is_what_the_simulators_own_book_reports() -> None:
    track = load_track("lake")
    course, expert = Course(track), Expert(track.line, 10.0, 0.0, 0)
    summary = DriveSummary()
    while course.laps < 0.2:
        world = replace(WORLD, time_s=course.time_s, laps=course.laps, interventions=course.interventions)
        summary.decision(decided(course.vehicle.speed_mph, world), 2.0, now_s=0.0)
        course.advance(*expert.control(course), 0.04)
    measures = course.measures
    assert summary.elapsed_s == pytest.approx(measures.elapsed_s, abs=0.05)
    assert summary.distance_m == pytest.approx(measures.distance_m, rel=0.005)
    assert summary.mean_speed_mph == pytest.approx(measures.mean_speed_mph, rel=0.005)
    assert summary.laps == pytest.approx(0.2, abs=0.002)
    assert summary.autonomy_percent == measures.autonomy_percent == 100.0


# Who drove


def test_autonomy_counts_humans_experts_and_the_simulator() -> None:
    summary = DriveSummary()
    now_s = 0.0

    def tell(decision: Decision | None, times: int = 1) -> None:
        nonlocal now_s
        for _ in range(times):
            if decision is None:
                summary.manual(0.1, now_s)
            else:
                summary.decision(decision, 2.0, now_s)
            now_s += 0.1

    pilot, expert = decided(), decided(driver="expert")
    tell(pilot, 1000)
    for _ in range(2):
        tell(None, 5)
        tell(BAD)  # who drives is not said in it
        tell(None, 5)
        tell(pilot)
    for _ in range(3):
        tell(expert, 4)
        tell(BAD)
        tell(expert, 4)
        tell(pilot)
    tell(pilot, 2001 - summary.telemetries)
    assert (summary.manual_stretches, summary.takeovers, summary.put_back) == (2, 3, 0)
    assert summary.elapsed_s == pytest.approx(200.0)
    assert summary.driven_s == pytest.approx(199.5)  # a tenth ends with each that could not be used
    assert summary.autonomy_percent == pytest.approx(100 * (1 - 6 * 5 / 199.5))
    assert summary.malformed == 5
    assert summary.frames == 2001 - 5 - 20


def test_autonomy_and_speed_are_unknown_where_nothing_was_driven() -> None:
    """As told by metadata too: neither is a number there."""
    no_number = decided(problem="the network gave no number", driver="brake")
    for decisions in ([], [BAD] * 30, [no_number] * 30, [decided()], [None] * 30):
        summary = DriveSummary()
        for i, decision in enumerate(decisions):
            if decision is None:
                summary.manual(0.1, i / 10)
            else:
                summary.decision(decision, 2.0, now_s=i / 10)
        assert summary.autonomy_percent is None
        assert "autonomy_percent" not in summary.as_metadata()
        assert summary_lines(summary)[1].startswith("autonomy unknown, because nothing was driven")
        assert (summary.mean_speed_mph is None) == (decisions != [no_number] * 30)


def test_the_time_in_which_nothing_could_be_used_is_no_driving() -> None:
    summary = DriveSummary()
    for i in range(301):
        summary.decision(decided() if i <= 100 else BAD, 2.0, now_s=i / 10)
    summary.manual(0.1, 30.1)
    assert summary.autonomy_percent == pytest.approx(100 * (1 - 6 / 10.1))
    assert summary_lines(summary)[1].startswith("autonomy 40.6 % of the 10.1 s that were driven, 1 intervention")
    assert summary_lines(summary)[-1] == "200 telemetries could not be used: not an object (200)"


def test_what_the_simulator_put_back_counts_since_the_drive_began() -> None:
    summary = DriveSummary()
    for i, interventions in enumerate((3, 3, 4, 4, 6)):
        summary.decision(
            decided(world=replace(WORLD, time_s=10.0 * i, interventions=interventions, laps=1.5)), 2.0
        )
    assert summary.put_back == 3
    for i, interventions in enumerate((0, 0, 1)):  # the simulator was started again
        summary.decision(
            decided(world=replace(WORLD, time_s=10.0 * i, interventions=interventions, laps=i / 4)), 2.0
        )
    assert summary.put_back == 4
    assert summary.laps == pytest.approx(0.5)
    assert summary.elapsed_s == pytest.approx(60.0)


# What is said


def test_the_metadata_has_a_unit_in_every_name_that_needs_one() -> None:
    summary = DriveSummary()
    for i in range(26):
        world = replace(WORLD, time_s=i / 25, laps=i / 100, interventions=i // 25)
        summary.decision(decided(world=world, in_flight=1 + i // 12), 2.0, i)
    summary.dropped_pictures, summary.dropped_rows = 4, 1
    summary.pushes, summary.unanswered = 3, 2
    metadata = summary.as_metadata()
    assert all(isinstance(value, str) for value in metadata.values())
    assert metadata.pop("clock") == "simulator"
    assert {name: float(value) for name, value in metadata.items()} == pytest.approx(
        {
            "frames": 26,
            "malformed": 0,
            "without_number": 0,
            "interventions": 1,
            "manual_stretches": 0,
            "takeovers": 0,
            "put_back": 1,
            "dropped_pictures": 4,
            "dropped_rows": 1,
            "pushes": 3,
            "unanswered": 2,
            "in_flight": 1,
            "in_flight_most": 3,
            "elapsed_s": 1.0,
            "driven_s": 1.0,
            "distance_m": 10 * MPH,
            "mean_speed_mph": 10.0,
            "autonomy_percent": 0.0,
            "laps": 0.25,
            **{f"parse_{which}_ms": 0.1 for which in ("p50", "p99", "max")},
            **{f"decode_{which}_ms": 0.2 for which in ("p50", "p99", "max")},
            **{f"network_{which}_ms": 1.0 for which in ("p50", "p99", "max")},
            **{f"total_{which}_ms": 2.0 for which in ("p50", "p99", "max")},
        },
        abs=5e-4,
    )


def test_the_lines_for_people() -> None:
    summary = DriveSummary()
    for i in range(1201):
        summary.decision(decided(world=replace(WORLD, time_s=i / 10, laps=i / 1000)), 2.0, now_s=0.0)
    summary.decision(BAD, 0.1, now_s=0.0)
    summary.decision(decided(driver="expert", world=replace(WORLD, time_s=120.0, laps=1.2)), 2.0, now_s=0.0)
    distance, autonomy, latency, malformed = summary_lines(summary)
    assert distance == "1,202 frames in 120.0 s by the simulator's clock: 1.20 laps, 536 m, 10.0 mph on average"
    assert autonomy == "autonomy 95.0 %, 1 intervention: 1 by the expert"
    assert latency.startswith("latency p50/p99/max in ms: parse 0.10/0.10/0.10, decode ")
    assert malformed == "1 telemetry could not be used: not an object (1)"


def test_the_live_line_shows_the_last_second() -> None:
    summary = DriveSummary()
    status = LiveStatus(summary)
    assert status.line(0.0) == ""
    for i in range(1, 401):  # 20 a second for ten seconds, then 50
        now_s = i / 20 if i <= 200 else 10 + (i - 200) / 50
        summary.decision(decided(speed_mph=10.1), 9.0 if i <= 200 else 1.9, now_s)
        line = status.line(now_s)
        if i == 200:
            assert line == "10.1 mph, steer +0.03, 20 Hz, 9.0 ms, 0.0 s ago"
    assert line == "10.1 mph, steer +0.03, 50 Hz, 1.9 ms, 0.0 s ago"
    assert status.line(16.5) == "10.1 mph, steer +0.03, 0 Hz, 1.9 ms, 2.5 s ago"
    summary.manual(0.1, 17.0)
    assert status.line(17.0).startswith("1 intervention, 10.1 mph, a human drives")


def test_the_live_line_shows_what_cannot_be_used() -> None:
    summary = DriveSummary()
    status = LiveStatus(summary)
    lines = []
    for i in range(1, 161):  # two seconds of good ones, two in which every fourth is bad, four of bad ones only
        bad = i > 80 or (i > 40 and i % 4 == 0)
        summary.decision(BAD if bad else decided(), 2.0, now_s=i / 20)
        lines.append(status.line(i / 20))
    assert lines[39] == "10.0 mph, steer +0.03, 20 Hz, 2.0 ms, 0.0 s ago"
    assert lines[78] == "10.0 mph, steer +0.03, 20 Hz, 5 bad, 0.0 s ago"
    assert lines[159] == "20 Hz, none of it usable, 0.0 s ago"
