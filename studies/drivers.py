"""The simulated keyboard and mouse drivers, compared with recordings of people: a table and a figure.

python studies/drivers.py sessions/lake_windows.mcap sessions/jungle.mcap ... [--figure drivers.png]

The logs are recordings of people (`bc-import FOLDER NAME`). Rows below 8 mph are left out, because people
stand at walls with full lock. The figure compares the first log with the keyboard driver, and the last log with
the mouse driver. The drivers drive without a renderer, so the study takes two minutes.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from figure_style import BLUE, DPI, ORANGE, figure_style, new_figure
from numpy.typing import NDArray
from printed_table import print_head, print_row

from common.car import MAX_STEERING_DEG
from recorder import Log
from recorder.rows.steering_habits import neighbours_mean
from simulator.driving.course import Course
from simulator.driving.drive_limits import DriverName
from simulator.driving.expert import Expert
from simulator.driving.person import make_driver
from simulator.driving.recovery_driving import SimulatedDriver, drive_for_recording
from simulator.driving.vehicle import STEP_S
from simulator.roads.track import load_track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

PLACES: Final = {"lake": ["lake"], "mountain": ["mountain"], "random:1 to 3": ["random:1", "random:2", "random:3"]}
PEOPLE: Final[tuple[DriverName, ...]] = ("keyboard", "mouse")
SPEEDS_MPH: Final = (10.0, 15.0, 20.0)
SEEDS: Final = (0, 1, 2)
SLOWEST_MPH: Final = 8.0
GAP_S: Final = 0.5  # rows farther apart belong to two drives
AROUND_S: Final = 0.25  # neighbours of a row are within this time before and after it
NOISE: Final = 0.03
LONGEST_LAG_S: Final = 1.5
STRIP_S: Final = 40.0


@dataclass(frozen=True)
class Drive:
    """The rows of a drive: arrays of one length."""

    name: str
    time_s: Floats
    steering_deg: Floats
    speed_mph: Floats
    left_road: int = 0  # number of times that the car left the road
    lag_s: float = math.nan  # of the steering behind the expert's

    @property
    def piece(self) -> NDArray[np.int64]:
        """The number of each row's stretch without a gap."""
        return np.cumsum(np.diff(self.time_s, prepend=self.time_s[0]) > GAP_S)


@dataclass(frozen=True)
class Presses:
    """Stretches of rows steered to one side, and the stretches straight ahead between them."""

    length_s: Floats
    largest_deg: Floats
    straight_s: Floats


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    people = [read(path) for path in arguments.logs]
    print_head(
        "steered by", "where", "rows a second", "mean mph", "exactly 0", "presses a minute", "press, s",
        "its largest, deg", "straight between, s", "values", "spread, deg", "at full lock", "ceiling",
        "lag, s", "left the road",
    )  # fmt: skip
    for person in people:
        print_drives("person", person)
    for name in PEOPLE:
        for place, tracks in PLACES.items():
            for mph in SPEEDS_MPH:
                where = f"{place} at {mph:g} mph"
                print_drives(name, *(drive(name, where, track, mph, seed) for track in tracks for seed in SEEDS))
    if arguments.figure is not None:
        shown = [
            drive(name, f"{track} at 15 mph", track, 15.0, 0)
            for name, track in zip(PEOPLE, ("lake", "mountain"), strict=True)
        ]
        draw(list(zip((people[0], people[-1]), shown, strict=True)), arguments.figure)


def read(path: Path) -> Drive:
    """The rows of a log with at least `SLOWEST_MPH`."""
    with Log(path) as log:
        vehicle = log.vehicle()
    time_ns, steering, speed = (vehicle[name].to_numpy() for name in ("log_time_ns", "steering", "speed_mph"))
    is_driving = speed >= SLOWEST_MPH
    time_s = (time_ns[is_driving] - time_ns[0]) / 1e9
    return Drive(path.stem, time_s, MAX_STEERING_DEG * steering[is_driving], speed[is_driving])


class Watched:
    """A driver that also records the expert's steering for each step."""

    def __init__(self, driver: SimulatedDriver, expert: Expert) -> None:
        self._driver, self._expert = driver, expert
        self.steered: list[float] = []
        self.experts: list[float] = []

    def control(self, course: Course) -> tuple[float, float]:
        command = self._driver.control(course)
        self.steered.append(command[0])
        self.experts.append(self._expert.control(course)[0])
        return command

    def lag_s(self) -> float:
        """The lag of the driver's steering behind the expert's: the one with the highest correlation."""
        steered, experts = np.array(self.steered), np.array(self.experts)
        lags = range(round(LONGEST_LAG_S / STEP_S))
        correlations = [np.corrcoef(steered[lag:], experts[: len(experts) - lag])[0, 1] for lag in lags]
        return int(np.argmax(correlations)) * STEP_S


def drive(name: DriverName, where: str, road: str, mph: float, seed: int) -> Drive:
    """A lap."""
    track = load_track(road)
    watched = Watched(make_driver(name, track.line, mph, NOISE, seed), Expert(track.line, mph))
    steps = list(drive_for_recording(Course(track), watched, 1.0, recovery_share=0.0, seed=seed))
    rows = [(step.time_s, MAX_STEERING_DEG * step.steering, step.speed_mph) for step in steps]
    time_s, steering_deg, speed_mph = np.array(rows).T
    left_road = sum(step.after_gap for step in steps)
    return Drive(where, time_s, steering_deg, speed_mph, left_road, watched.lag_s())


def presses(drive: Drive) -> Presses:
    side, piece = np.sign(drive.steering_deg), drive.piece
    is_new = np.concatenate([[True], (np.diff(side) != 0) | (np.diff(piece) != 0)])
    starts = np.flatnonzero(is_new)
    ends = np.append(starts[1:], len(side))
    steered = side[starts] != 0
    lengths_s = (ends - starts) * step_s(drive)
    largest = np.maximum.reduceat(np.abs(drive.steering_deg), starts)
    return Presses(lengths_s[steered], largest[steered], lengths_s[~steered])


def step_s(drive: Drive) -> float:
    steps = np.diff(drive.time_s)
    return float(np.median(steps[(steps > 0) & (steps <= GAP_S)]))


def ceiling(drive: Drive) -> float:
    """The correlation of each row's steering with the mean of its neighbours: the most that a network can
    reach."""
    neighbours = neighbours_mean(drive.steering_deg, drive.time_s, AROUND_S)
    is_known = np.isfinite(neighbours)
    return float(np.corrcoef(drive.steering_deg[is_known], neighbours[is_known])[0, 1])


def print_drives(who: str, *drives: Drive) -> None:
    """Print a row with the means over drives, and with the quartiles of all their presses."""
    drive_presses = [presses(drive) for drive in drives]
    minutes = sum(len(drive.time_s) * step_s(drive) for drive in drives) / 60

    def mean(values: Sequence[float]) -> float:
        return float(np.mean(values))

    def quartiles(values: Sequence[Floats], digits: int) -> str:
        low, middle, high = np.percentile(np.concatenate(values), [25, 50, 75])
        return f"{low:.{digits}f} **{middle:.{digits}f}** {high:.{digits}f}"

    is_person = who == "person"
    cells = (
        who,
        drives[0].name,
        f"{mean([1 / step_s(drive) for drive in drives]):.1f}",
        f"{mean([drive.speed_mph.mean() for drive in drives]):.0f}",
        f"{mean([(drive.steering_deg == 0).mean() for drive in drives]):.0%}".replace("%", " %"),
        f"{sum(len(part.length_s) for part in drive_presses) / minutes:.0f}",
        quartiles([part.length_s for part in drive_presses], 2),
        quartiles([part.largest_deg for part in drive_presses], 0),
        quartiles([part.straight_s for part in drive_presses], 2),
        f"{mean([len(np.unique(drive.steering_deg)) for drive in drives]):.0f}",
        f"{mean([drive.steering_deg.std() for drive in drives]):.1f}",
        f"{mean([(np.abs(drive.steering_deg) > 24.9).mean() for drive in drives]):.1%}".replace("%", " %"),
        f"{mean([ceiling(drive) for drive in drives]):.2f}",
        "" if is_person else f"{mean([drive.lag_s for drive in drives]):.2f}",
        "" if is_person else f"{sum(drive.left_road for drive in drives)}",
    )
    print_row(*cells)


def draw(pairs: Sequence[tuple[Drive, Drive]], path: Path) -> None:
    """Draw strips of steering over time, each person above the driver that imitates people; below them
    histograms."""
    with figure_style():
        figure = new_figure(7.0)
        grid = figure.add_gridspec(5, 4, height_ratios=[1, 1, 1, 1, 1.7])
        colours = (BLUE, ORANGE)
        for pair, (person, driver) in enumerate(pairs):
            for below, shown in enumerate((person, driver)):
                axes = figure.add_subplot(grid[2 * pair + below, :])
                who = f"{('keyboard', 'mouse')[pair]} driver" if below else "person"
                strip(axes, shown, f"{who}, {shown.name}")
                axes.lines[0].set_color(colours[below])
                if pair == below == 1:
                    axes.set_xlabel("time, s")
            lengths = [presses(shown).length_s for shown in (person, driver)]
            values = [np.abs(shown.steering_deg[shown.steering_deg != 0]) for shown in (person, driver)]
            for column, (what, data, bins) in enumerate(
                (
                    ("length of a press, s", lengths, np.arange(0.05, 2.06, 0.2)),
                    ("steering other than 0, deg", values, np.linspace(0.0, 25.0, 13)),
                )
            ):
                axes = figure.add_subplot(grid[4, 2 * pair + column])
                for numbers, colour in zip(data, colours, strict=True):
                    weights = np.full(len(numbers), 1 / len(numbers))
                    clipped = np.minimum(numbers, bins[-1])
                    axes.hist(clipped, bins.tolist(), weights=weights, histtype="step", color=colour)
                axes.set_xlabel(what)
                axes.set_title(("keyboard", "mouse")[pair])
                if pair == column == 0:
                    axes.set_ylabel("share")
        figure.savefig(path, dpi=DPI, bbox_inches="tight")


def strip(axes: Axes, drive: Drive, title: str) -> None:
    """Draw the stretch of the drive whose steering has a spread nearest to that of the whole drive."""
    spread = drive.steering_deg.std()
    rows = round(STRIP_S / step_s(drive))
    begins = np.arange(0, max(1, len(drive.time_s) - rows), 10)
    sound = [at for at in begins.tolist() if drive.piece[at] == drive.piece[min(at + rows, len(drive.time_s) - 1)]]
    begin = min(sound, key=lambda at: abs(drive.steering_deg[at : at + rows].std() - spread))
    part = slice(begin, begin + rows)
    axes.plot(drive.time_s[part] - drive.time_s[begin], drive.steering_deg[part], linewidth=0.9)
    axes.axhline(0.0, color="0.8", linewidth=0.5, zorder=0)
    axes.set_title(title, loc="left")
    axes.set_ylim(-27, 27)
    axes.set_yticks([-25, 0, 25])
    axes.set_xlim(0, STRIP_S)
    axes.set_ylabel("deg")


if __name__ == "__main__":
    main()
