"""Speed in the built-in simulator: the expert's at each set speed, and how well a controller follows a target.

python studies/driving_fast.py

Nothing is rendered: four tables take two or three minutes. The expert steers in all of them.

1. The expert's lap at each set speed, and recording it with pushes: rows, and how often the car was put back.
2. The controller follows the speed that the expert has 0.5 s after the same place: with `follow`, and with the set
   speed's controller and a changing set speed. Commands take effect one message late, as in a drive.
3. The same with a wrong target, which is too fast everywhere by some mph.
4. The speed 0.5 s later in recordings at one and at several set speeds, at places where 30 mph is possible. A
   network can at best learn its mean, because no picture shows the set speed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from printed_table import print_head, print_row

from common.car import MPS_PER_MPH
from drive.control.speed_controller import TARGET_AHEAD_S, SpeedController
from simulator.driving.course import Course
from simulator.driving.expert import Expert, plan_speed
from simulator.driving.recovery_driving import DriveStep, drive_for_recording
from simulator.driving.vehicle import GRAVITY_MPS2, GRIP
from simulator.roads.track import Track, load_track

Floats = NDArray[np.float64]
Throttle = Callable[[float, float, float], float]
"""Computes the throttle from time in s, speed and target in mph."""

RATE_S: Final = 0.04
SPEEDS_MPH: Final = (10.0, 20.0, 30.0)
HAIRPINS: Final = 20  # roads
SETTLED_S: Final = 8.0  # after the start at rest


@dataclass(frozen=True)
class Lap:
    max_offset: float  # share of the half width
    max_mps2: float  # sideways
    mean_mph: float
    interventions: int
    errors_mph: Floats  # relative to the expert at the same place


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    roads = {
        "lake": [load_track("lake")],
        "mountain": [load_track("mountain")],
        f"hairpins ({HAIRPINS})": [load_track(f"hairpins:{seed}") for seed in range(HAIRPINS)],
    }
    print_experts(roads)
    print_followers(roads)
    print_wrong_targets(roads)
    print_labels(roads)


def print_experts(roads: dict[str, list[Track]]) -> None:
    print_head(
        "road", "set speed, mph", "its mean, mph", "offset, max", "sideways, max m/s²", "rows a lap with pushes",
        "put back", "sideways then, 99th percentile",
    )  # fmt: skip
    for name, tracks in roads.items():
        for mph in SPEEDS_MPH:
            laps = [drive_lap(track, mph) for track in tracks]
            recorded = [record(track, mph, seed) for seed, track in enumerate(tracks)]
            pushed = np.concatenate([sideways_mps2(steps) for steps in recorded])
            put_back = sum(step.after_gap and not step.recovering for steps in recorded for step in steps)
            print_row(
                name, f"{mph:g}", f"{np.mean([lap.mean_mph for lap in laps]):.1f}",
                f"{max(lap.max_offset for lap in laps):.2f}", f"{max(lap.max_mps2 for lap in laps):.1f}",
                f"{np.mean([len(steps) for steps in recorded]):,.0f}", f"{put_back}",
                f"{np.percentile(pushed, 99):.1f}",
            )  # fmt: skip
    print(f"\nThe tyres hold {GRIP * GRAVITY_MPS2:.1f} m/s².\n")


def print_followers(roads: dict[str, list[Track]]) -> None:
    print_head(
        "road", "set speed, mph", "controller", "rms, mph", "too fast, max", "too slow, max", "interventions"
    )
    for name, tracks in roads.items():
        for mph in SPEEDS_MPH[1:]:
            for who, make in (("set speed, changed", changed_set_speed), ("`follow`", following)):
                laps = [drive_lap(track, mph, make(mph)) for track in tracks]
                errors = np.concatenate([lap.errors_mph for lap in laps])
                print_row(
                    name, f"{mph:g}", who, f"{np.sqrt((errors**2).mean()):.2f}", f"{errors.max():.1f}",
                    f"{-errors.min():.1f}", f"{sum(lap.interventions for lap in laps)}",
                )  # fmt: skip
    print()


def print_wrong_targets(roads: dict[str, list[Track]]) -> None:
    print_head("road", "target too fast by, mph", "offset, max", "sideways, max m/s²", "interventions")
    for name, tracks in roads.items():
        for wrong_mph in (0.0, 2.0, 4.0, 6.0, 8.0):
            laps = [drive_lap(track, 30.0, following(30.0), wrong_mph) for track in tracks]
            print_row(
                name, f"{wrong_mph:g}", f"{max(lap.max_offset for lap in laps):.2f}",
                f"{max(lap.max_mps2 for lap in laps):.1f}", f"{sum(lap.interventions for lap in laps)}",
            )  # fmt: skip


def print_labels(roads: dict[str, list[Track]]) -> None:
    print()
    print_head(
        "road", "recorded at, mph", "speed 0.5 s later where 30 mph is possible: mean", "standard deviation"
    )
    for name, tracks in roads.items():
        for speeds_mph in ((30.0,), (20.0, 30.0), SPEEDS_MPH):
            labels = np.concatenate([clear_road_labels(track, mph) for track in tracks for mph in speeds_mph])
            recorded_at = " ".join(f"{mph:g}" for mph in speeds_mph)
            print_row(name, recorded_at, f"{labels.mean():.1f}", f"{labels.std():.1f}")


def clear_road_labels(track: Track, mph: float) -> Floats:
    """The speeds in mph half a second after each row at which 30 mph is possible."""
    steps = record(track, mph, 0)
    planned_mph = plan_speed(track.line, 30.0 * MPS_PER_MPH) / MPS_PER_MPH
    later = round(TARGET_AHEAD_S / 0.1)
    return np.array(
        [
            after.speed_mph
            for before, after in zip(steps, steps[later:], strict=False)
            if after.time_s - before.time_s < TARGET_AHEAD_S + 0.05
            and planned_mph[int(before.progress_m / track.line.step_m) % len(planned_mph)] > 29.5
        ]
    )


def changed_set_speed(_: float) -> Throttle:
    controller = SpeedController(0.0)

    def throttle(time_s: float, speed_mph: float, target_mph: float) -> float:
        controller.set_speed_mph = target_mph
        return controller.throttle(speed_mph)

    return throttle


def following(mph: float) -> Throttle:
    return SpeedController(mph).follow


def drive_lap(track: Track, mph: float, throttle: Throttle | None = None, wrong_mph: float = 0.0) -> Lap:
    """A lap steered by the expert, at the expert's speed or with the throttle that `throttle` gives."""
    course, expert = Course(track), Expert(track.line, mph)
    times_s, places_m, speeds_mph = experts_speed(track, mph) if throttle is not None else (np.zeros(1),) * 3
    command, errors, max_mps2 = (0.0, 0.0), [], 0.0
    while course.laps < 1.0:
        answer = expert.control(course)
        if throttle is not None:
            expert_s = np.interp(course.progress_m, places_m, times_s)  # the expert's time at this place
            target_mph = float(np.interp(expert_s + TARGET_AHEAD_S, times_s, speeds_mph)) + wrong_mph
            speed_mph = course.vehicle.speed_mph
            answer = answer[0], throttle(course.time_s, speed_mph, target_mph)
            if course.time_s > SETTLED_S:
                errors.append(speed_mph - float(np.interp(expert_s, times_s, speeds_mph)))
        course.advance(*command, RATE_S)
        command = answer
        max_mps2 = max(max_mps2, abs(course.vehicle.lateral_mps2))
        if course.intervention_due:
            course.intervene()
    measures = course.measures
    return Lap(measures.max_offset, max_mps2, measures.mean_speed_mph, measures.interventions, np.array(errors))


def experts_speed(track: Track, mph: float) -> tuple[Floats, Floats, Floats]:
    """The expert's time in s, progress in m and speed in mph along a lap."""
    course, expert, rows = Course(track), Expert(track.line, mph), []
    while course.laps < 1.05:
        rows.append((course.time_s, course.progress_m, course.vehicle.speed_mph))
        course.advance(*expert.control(course), RATE_S)
    times_s, places_m, speeds_mph = np.array(rows).T
    return times_s, places_m, speeds_mph


def record(track: Track, mph: float, seed: int) -> list[DriveStep]:
    """Record a lap with the expert as `bc-record` does, but without pictures."""
    return list(drive_for_recording(Course(track), Expert(track.line, mph, 0.03, seed), 1.0, seed=seed))


def sideways_mps2(steps: Sequence[DriveStep]) -> Floats:
    """Lateral acceleration: speed times the rate of the heading, without steps across gaps."""
    heading = np.unwrap([step.pose.heading_rad for step in steps])
    passed_s = np.diff([step.time_s for step in steps])
    speed_mps = MPS_PER_MPH * np.array([step.speed_mph for step in steps[1:]])
    sound = passed_s < 0.15
    accelerations: Floats = np.abs(np.diff(heading) / passed_s * speed_mps)[sound]
    return accelerations


if __name__ == "__main__":
    main()
