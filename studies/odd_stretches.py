"""Does `recorder.rows.odd_stretches` find the faults of a drive, and nothing else?

python studies/odd_stretches.py
python studies/odd_stretches.py --logs sessions/*.mcap

Drives the built-in simulator, without pictures, on four tracks at 10 and at 30 mph: with the expert and the
keyboard driver, and with a fault after every half minute. The speed has no sign, as in recordings of Udacity's
simulator. A fault is found if a stretch of its kind, or of leaving the road, covers half of its rows. Rows of
stretches are false if they are more than four seconds from a fault. With --logs, it prints the odd stretches of
recordings.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from printed_table import print_head, print_row

from recorder import Log
from recorder.log.road_places import beyond_edge_m
from recorder.log.road_places import states_of as states_of_log
from recorder.rows.odd_stretches import OddStretch, odd_stretches
from recorder.rows.row_quality import States
from simulator.driving.course import Course
from simulator.driving.drive_limits import DriverName
from simulator.driving.person import make_driver
from simulator.driving.recovery_driving import SimulatedDriver, drive_for_recording
from simulator.rendering.world_maps import build_world
from simulator.roads.track import load_track

TRACKS: Final = ("lake", "mountain", "random:1", "random:2")
SPEEDS_MPH: Final = (10.0, 30.0)
FAULTS_EACH: Final = 4
DRIVEN_S: Final = 30.0
NEAR_S: Final = 4.0
RATE_HZ: Final = 10
STEPS_EACH: Final = 5


@dataclass(frozen=True)
class Drive:
    """A car, its driver, and the rows that were recorded."""

    course: Course
    driver: SimulatedDriver
    rows: list[tuple[float, ...]]

    def row(self, steering: float, throttle: float) -> None:
        course = self.course
        speed_mph = abs(course.vehicle.speed_mph)
        state = (course.time_s, steering, max(0.0, throttle), max(0.0, -throttle), speed_mph)
        self.rows.append((*state, abs(course.offset_m) - course.half_width_m, course.vehicle.heading_rad))
        for _ in range(STEPS_EACH):
            course.advance(steering, throttle)

    def drives(self, seconds: float) -> None:
        for _ in range(round(seconds * RATE_HZ)):
            self.row(*self.driver.control(self.course))

    def holds(self, seconds: float, throttle: float, steering: float | None = None) -> None:
        """Hold a pedal, and the steering; without `steering`, steer as the driver does."""
        for _ in range(round(seconds * RATE_HZ)):
            self.row(self.driver.control(self.course)[0] if steering is None else steering, throttle)

    def stand(self) -> None:
        self.course.vehicle = replace(self.course.vehicle, speed_mps=0.0, yaw_rate_radps=0.0)

    def put_back(self) -> None:
        """On the road's line, without a row."""
        self.course.displace(0.0, 0.0, 2.0)

    def until_it_stands(self, throttle: float) -> None:
        for _ in range(60 * RATE_HZ):
            if self.course.vehicle.speed_mph < 0.7:
                self.stand()
                return
            self.holds(1 / RATE_HZ, throttle)


def backwards(drive: Drive) -> None:
    drive.until_it_stands(-1.0)
    drive.holds(6.0, -1.0, 0.05)
    drive.holds(2.0, 1.0)


def crash(drive: Drive) -> None:
    for _ in range(RATE_HZ):  # at a wall
        drive.stand()
        drive.holds(1 / RATE_HZ, 1.0, 0.0)
    drive.stand()
    drive.holds(2.5, -1.0, 1.0)
    drive.holds(1.5, 1.0, -1.0)


def parked(drive: Drive) -> None:
    drive.until_it_stands(-1.0)
    for _ in range(8 * RATE_HZ):
        drive.stand()
        drive.holds(1 / RATE_HZ, 0.0, 0.0)


def coasting(drive: Drive) -> None:
    drive.until_it_stands(0.0)
    if drive.course.vehicle.speed_mps:  # downhill
        drive.until_it_stands(-1.0)
    drive.holds(0.5, 0.0)


def creeping(drive: Drive) -> None:
    drive.until_it_stands(-1.0)
    for _ in range(6 * RATE_HZ):
        drive.holds(1 / RATE_HZ, 0.3 if drive.course.vehicle.speed_mph < 0.8 else -0.1)


def stuck_steering(drive: Drive) -> None:
    drive.holds(4.0, 0.3, 0.01)


def off_road(drive: Drive) -> None:
    """Put the car next to the road, and let the driver return."""
    drive.course.displace(1.5 * drive.course.half_width_m, 0.0, 0.0)
    for _ in range(10 * RATE_HZ):
        if not drive.course.off_road:
            return
        drive.drives(1 / RATE_HZ)


def leaving_the_road(drive: Drive) -> None:
    """Steer to the side until the car leaves the road; then it is put back."""
    while not drive.course.off_road:
        drive.holds(1 / RATE_HZ, 0.3, 0.5)
    drive.put_back()


def weaving(drive: Drive) -> None:
    """Full lock to either side for half a second each, as the road allows."""
    while drive.course.vehicle.speed_mph > 8.0:
        drive.holds(1 / RATE_HZ, -0.5)
    side = 1.0
    for _ in range(30):
        wanted = drive.driver.control(drive.course)[0]
        side = -side if abs(wanted) < 0.8 else math.copysign(1.0, wanted)
        drive.holds(0.5, 0.2, side)
        if drive.course.off_road:
            drive.put_back()


def wheel_off_the_road(drive: Drive) -> None:
    """Follow the road with the outer wheels 0.4 m off it, for ten seconds."""
    course = drive.course
    course.displace(course.half_width_m - 0.4, 0.0, 0.0)
    for _ in range(10 * RATE_HZ):
        steering, throttle = drive.driver.control(course)
        drive.row(steering, throttle)
        course.displace(course.half_width_m - 0.4, 0.0, 0.0)


ON_PLACES: Final = (off_road, leaving_the_road, weaving, wheel_off_the_road)
FAULTS: Final[dict[str, Callable[[Drive], None]]] = {
    fault.__name__: fault for fault in (backwards, crash, parked, coasting, creeping, stuck_steering, *ON_PLACES)
}


def states_of(rows: Sequence[tuple[float, ...]]) -> States:
    table = np.array(rows, np.float64)
    return States(np.arange(len(rows)), np.rint(table[:, 0] * 1e9).astype(np.int64), *table[:, 1:].T.copy())


def drive_with(
    course: Course, driver: SimulatedDriver, fault: Callable[[Drive], None]
) -> tuple[States, list[tuple[int, int]]]:
    """The rows of a drive, and the first and the last row of each fault."""
    course.start()
    drive = Drive(course, driver, [])
    places = []
    for _ in range(FAULTS_EACH):
        drive.drives(DRIVEN_S)
        first = len(drive.rows)
        fault(drive)
        places.append((first, len(drive.rows) - 1))
        drive.put_back()
    drive.drives(DRIVEN_S)
    return states_of(drive.rows), places


def measure(stretches: list[OddStretch], kind: str, places: list[tuple[int, int]]) -> tuple[int, int]:
    """The number of faults that were found, and the number of false rows."""
    kinds = (kind, "leaving_the_road")  # a fault may end there
    rows_of_kind = rows_of([stretch for stretch in stretches if stretch.kind in kinds])
    near = round(NEAR_S * RATE_HZ)
    allowed = {row for first, last in places for row in range(first - near, last + near + 1)}
    detected = sum(2 * len(rows_of_kind & {*range(a, b + 1)}) >= b + 1 - a for a, b in places)
    return detected, len(rows_of(stretches) - allowed)


def rows_of(stretches: Sequence[OddStretch]) -> set[int]:
    return {row for stretch in stretches for row in range(stretch.first_row, stretch.last_row + 1)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=Path, nargs="+", default=[])
    logs = parser.parse_args().logs
    for path in logs:
        with Log(path) as log:
            stretches = odd_stretches(states_of_log(log))
        print(f"{path.stem}: {'; '.join(map(str, stretches)) or 'nothing'}")
    if logs:
        return
    print_head("drive", "faults", "found", "missed", "false rows", "of rows")
    results: dict[str, Counter[str]] = {}
    for track_name in TRACKS:
        track = load_track(track_name)
        course = Course(track, build_world(track).height_m)
        for mph in SPEEDS_MPH:
            names: tuple[DriverName, ...] = ("expert", "keyboard")
            for name in names:
                driver = make_driver(name, track.line, mph, 0.03, 0)
                steps = list(drive_for_recording(course, driver, 1.0, RATE_HZ, 0.35, 0))
                states = states_of(
                    [
                        (step.time_s, step.steering, step.throttle, step.brake, abs(step.speed_mph))
                        for step in steps
                    ]
                )
                poses = np.array([(step.pose.x_m, step.pose.y_m, step.pose.heading_rad) for step in steps])
                states = replace(states, beyond_m=beyond_edge_m(track_name, "", *poses.T))
                count = results.setdefault(f"{name}, a lap with recoveries", Counter())
                stretches = odd_stretches(states)
                count.update(rows=len(states.row), false=measure(stretches, "", [])[1])
            for kind, fault in FAULTS.items():
                driver = make_driver("expert", track.line, mph, 0.03, 0)
                states, places = drive_with(course, driver, fault)
                detected, false = measure(odd_stretches(states), kind, places)
                count = results.setdefault(kind, Counter())
                count.update(rows=len(states.row), faults=len(places), found=detected, false=false)
    for kind, count in results.items():
        missed = count["faults"] - count["found"]
        print_row(kind, count["faults"], count["found"], missed, count["false"], f"{count['rows']:,}")


if __name__ == "__main__":
    main()
