"""How true the picture from beside a recorded one is (dataset/viewpoint.py), before anything is driven by it.

python benchmarks/viewpoint.py sides sessions/*.mcap      # the centre camera's, warped to the side cameras' places
python benchmarks/viewpoint.py rendered lake mountain     # warped pictures against what the simulator renders
python benchmarks/viewpoint.py line sessions/lake.mcap    # the line by steering and speed against the poses
python benchmarks/viewpoint.py drive sessions/lake.mcap runs/first      # driven on warped and on true pictures
python benchmarks/viewpoint.py figure docs/pictures/viewpoint.jpg sessions/lake.mcap sessions/mountain.mcap

Errors are the mean absolute difference of grey levels (0 .. 255) over what the network sees of the picture and the
warp knows, without the bonnet. Beside the warp's stand that of no warp, and of the plain shift to the side that
fits best: one number of columns for all pictures of a side, chosen with the true pictures at hand.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import CAMERAS, MPS_PER_MPH, Camera
from dataset.loader.log_views import LogViews
from dataset.picture_spec import ORIGINAL
from dataset.preprocess import Image, decode, preprocess
from dataset.recorded_line import curvature, stretches_to_drive
from dataset.viewpoint import Viewpoint
from model import load_pilot
from model.evaluation.recorded_drive import drive_views
from recorder import Log
from recorder.log.row_quality import States
from recorder.log.session_car import Car, built_in, car_of
from simulator.driving.simulation import Simulation
from simulator.driving.vehicle import AXLE_TO_CENTRE_M, CarState

MOMENTS: Final = 30  # of a log, or of a lap
SHIFTS: Final = range(-80, 81, 4)  # columns
VIEWS: Final = ((0.5, 0.0), (1.0, 0.0), (1.5, 0.0), (0.0, 5.0), (0.0, 10.0), (0.5, -5.0), (1.0, 5.0), (1.0, 10.0))
"""Metres to the left and degrees to the left; each is also measured to the right."""

Moment = dict[Camera, Image]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="what", required=True)
    commands.add_parser("sides").add_argument("logs", type=Path, nargs="+")
    commands.add_parser("rendered").add_argument("tracks", nargs="+")
    commands.add_parser("line").add_argument("logs", type=Path, nargs="+")
    drive = commands.add_parser("drive")
    drive.add_argument("log", type=Path)
    drive.add_argument("runs", type=Path, nargs="+")
    figure = commands.add_parser("figure")
    figure.add_argument("picture", type=Path)
    figure.add_argument("logs", type=Path, nargs="+")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    if arguments.what == "sides":
        print("| log | pictures | no warp | best shift | warped | of the road: no warp | best shift | warped |")
        for log in arguments.logs:
            sides(log)
    elif arguments.what == "rendered":
        print("| track | left m, degrees | known | no warp | best shift | centre camera warped | nearest warped |")
        for track in arguments.tracks:
            rendered(track)
    elif arguments.what == "line":
        print("| log | after s | m driven | aside, m: straight on | by steering | with the lag | turned, deg |")
        for log in arguments.logs:
            line(log)
    elif arguments.what == "drive":
        print(
            "| run | pictures | interventions | mean offset, m | largest | correlation of offsets | of steering |"
        )
        for run in arguments.runs:
            drive_both(arguments.log, run)
    else:
        draw(arguments.picture, arguments.logs)


def moments(log: Log, count: int = MOMENTS) -> list[Moment]:
    """Pictures of all cameras at rows spread over what can be driven of a log."""
    states = States.of(log.vehicle())
    can_be = stretches_to_drive(states, np.ones(len(states.row), np.bool_))
    rows = np.concatenate([states.row[each.first : each.end] for each in can_be])
    chosen = rows[np.linspace(0, len(rows) - 1, count).round().astype(int)].tolist()
    return [{camera: decode(log.picture(row, camera)) for camera in CAMERAS} for row in chosen]


def sides(path: Path) -> None:
    with Log(path) as log:
        geometry = car_of(log)
        taken = moments(log)
    viewpoint = Viewpoint(geometry, 320, 160)
    by_side: list[list[tuple[Image, Image, Image, NDArray[np.bool_]]]] = []
    for side in ("left", "right"):
        found = []
        for pictures in taken:
            view = viewpoint.view({"center": pictures["center"]}, geometry.left_m[side], 0.0)
            known = view.is_known & ~is_bonnet(geometry, side) & ~is_bonnet(geometry, "center")
            found.append((pictures["center"], view.picture, pictures[side], known))
        by_side.append(found)
    columns = []
    for rows in (ORIGINAL.crop_slice(160), slice(64, ORIGINAL.crop_slice(160).stop)):
        columns.append(mean([errors(found, rows) for found in by_side]))
    print(f"| {path.stem} | {2 * len(taken)} | {cells(columns[0])} | {cells(columns[1])} |", flush=True)


def rendered(track: str) -> None:
    simulation = Simulation(track)
    course, viewpoint = simulation.course, Viewpoint(built_in(), 320, 160)
    arcs = np.arange(MOMENTS) * course.line.length_m / MOMENTS
    taken = [
        {camera: picture_at(simulation, arc, 0.0, 0.0, camera) for camera in CAMERAS} for arc in arcs.tolist()
    ]
    for left_m, left_deg in VIEWS:
        results, shares = [], []
        for sign in (1, -1):
            aside_m, turn_rad = sign * left_m, math.radians(sign * left_deg)
            by_centre, by_nearest = [], []
            for arc, pictures in zip(arcs.tolist(), taken, strict=True):
                true = picture_at(simulation, arc, aside_m, turn_rad, "center")
                nearest = viewpoint.view(pictures, aside_m, turn_rad)
                centre = viewpoint.view(pictures, aside_m, turn_rad, "center")
                known = nearest.is_known & centre.is_known & ~is_bonnet(built_in(), "center")
                by_centre.append((pictures["center"], centre.picture, true, known))
                by_nearest.append((pictures["center"], nearest.picture, true, known))
                shares.append(nearest.is_known[ORIGINAL.crop_slice(160)].mean())
            without, shifted, warped = errors(by_centre, ORIGINAL.crop_slice(160))
            results.append((without, shifted, warped, errors(by_nearest, ORIGINAL.crop_slice(160))[2]))
        share = f"{100 * float(np.mean(shares)):.0f} %"
        print(f"| {track} | {left_m:g} m, {left_deg:g} | {share} | {cells(mean(results))} |", flush=True)


def picture_at(simulation: Simulation, arc_m: float, left_m: float, turn_rad: float, camera: Camera) -> Image:
    """What a camera sees where the car's rear axle is `left_m` beside the centre line's at `arc_m`."""
    simulation.course.start(arc_m)
    simulation.course.displace(left_m + AXLE_TO_CENTRE_M * math.sin(turn_rad), turn_rad, 0.0)
    return decode(simulation.jpeg(camera))


def errors(
    found: Sequence[tuple[Image, Image, Image, NDArray[np.bool_]]], rows: slice
) -> tuple[float, float, float]:
    """Of pictures as they were taken, warped, and true, with the pixels to compare: the error without a warp, with
    the best shift, and with the warp."""

    def error(pictures: Sequence[Image], masks: Sequence[NDArray[np.bool_]]) -> float:
        pairs = zip(pictures, found, masks, strict=True)
        return float(
            np.mean(
                [np.abs(a[rows].astype(np.int16) - true[rows])[mask].mean() for a, (_, _, true, _), mask in pairs]
            )
        )

    known = [mask[rows] for _, _, _, mask in found]
    taken = [picture for picture, _, _, _ in found]
    shifted = []
    for shift in SHIFTS:
        there = np.arange(320) - shift
        is_there = (there >= 0) & (there < 320)
        moved = [picture[:, np.clip(there, 0, 319)] for picture in taken]
        shifted.append(error(moved, [mask & is_there for mask in known]))
    return error(taken, known), min(shifted), error([warped for _, warped, _, _ in found], known)


def line(path: Path) -> None:
    """The line by steering and speed against the log's poses, from many places of the log on."""
    with Log(path) as log:
        geometry, states = car_of(log), States.of(log.vehicle())
        poses = {m.sequence: pose for m, pose in log.decoded("/pose")}
    x, y, heading = (np.array([place(poses[row])[k] for row in states.row.tolist()]) for k in range(3))
    for seconds in (1, 2, 4):
        found = []
        for each in stretches_to_drive(states, np.ones(len(states.row), np.bool_)):
            for first in range(each.first, each.end, 5):
                time_s = (states.time_ns[first : each.end] - states.time_ns[first]) / 1e9
                last = int(np.searchsorted(time_s, seconds - 1e-3))
                if last >= len(time_s):
                    break
                part = slice(first, first + last + 1)
                dx, dy = x[part][-1] - x[first], y[part][-1] - y[first]
                cos, sin = math.cos(heading[first]), math.sin(heading[first])
                true = np.array([dx * cos + dy * sin, -dx * sin + dy * cos])
                turned = math.remainder(heading[part][-1] - heading[first], math.tau)
                ways = [driven(states, part, geometry, lag_s) for lag_s in (0.0, geometry.lag_s)]
                found.append(
                    (
                        math.hypot(*true),
                        abs(true[1]),
                        *(abs(way[1] - true[1]) for way in ways),
                        abs(math.degrees(ways[1][2] - turned)),
                    )
                )
        print(f"| {path.stem} | {seconds} | {cells(np.mean(found, axis=0))} |", flush=True)


def driven(states: States, part: slice, geometry: Car, lag_s: float) -> tuple[float, float, float]:
    """Metres ahead and to the left, and the turn in rad, after some rows."""
    time_s = (states.time_ns[part] - states.time_ns[part.start]) / 1e9
    fine = np.arange(0.0, time_s[-1], 0.01)
    bends = [curvature(each, geometry) for each in np.interp(fine, time_s, states.steering[part]).tolist()]
    share = 1.0 - math.exp(-0.01 / lag_s) if lag_s else 1.0
    ahead = left = turn = 0.0
    bend = bends[0]
    for wanted, mph in zip(bends, np.interp(fine, time_s, states.speed_mph[part]).tolist(), strict=True):
        bend += share * (wanted - bend)
        way_m = 0.01 * mph * MPS_PER_MPH
        ahead, left = ahead + way_m * math.cos(turn), left + way_m * math.sin(turn)
        turn += way_m * bend
    return ahead, left, turn


class RenderedViews(LogViews):
    """A log of the built-in simulator, whose pictures are rendered where the car is instead of warped."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with Log(path) as log:
            self._simulation = Simulation(log.metadata["track"])
            self._poses = {message.sequence: place(pose) for message, pose in log.decoded("/pose")}

    def seen(self, number: int, left_m: float, turn_rad: float) -> tuple[Image, float]:
        x, y, heading = self._poses[int(self.states.row[number])]
        x, y = x - left_m * math.sin(heading), y + left_m * math.cos(heading)
        heading += turn_rad
        middle = x + AXLE_TO_CENTRE_M * math.cos(heading), y + AXLE_TO_CENTRE_M * math.sin(heading)
        course = self._simulation.course
        course.vehicle = CarState(*middle, heading)
        return preprocess(decode(self._simulation.jpeg("center", course.pose))), 1.0


def drive_both(log: Path, run: Path) -> None:
    pilot = load_pilot(run)
    pilot.warm_up()
    drives = []
    for kind in (LogViews, RenderedViews):
        with kind(log) as views:
            drives.append(drive_views(pilot.predict, views, departure_m=1.5))
    first, second = (np.array([(row.left_m, row.steering) for row in drive.moments]).T for drive in drives)
    offset, steering = (float(np.corrcoef(*pair)[0, 1]) for pair in zip(first, second, strict=True))
    ends = f"{offset:.2f} | {steering:.2f}", "|"
    for name, drive, end in zip(("warped", "rendered"), drives, ends, strict=True):
        found = f"{drive.interventions} | {drive.mean_offset_m:.2f} | {drive.max_offset_m:.2f}"
        print(f"| {run.name} | {name} | {found} | {end} |", flush=True)


def place(message: object) -> tuple[float, float, float]:
    """x, y and heading of a foxglove.PoseInFrame."""
    pose = message.pose  # type: ignore[attr-defined]
    q = pose.orientation
    heading = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
    return pose.position.x, pose.position.y, heading


def is_bonnet(geometry: Car, camera: Camera) -> NDArray[np.bool_]:
    columns, rows = np.array(geometry.bonnet[camera]).T
    top = np.interp(np.arange(320) + 0.5, columns, rows, left=160, right=160)
    return np.asarray(np.arange(160)[:, None] >= np.floor(top), np.bool_)


def mean(rows: Sequence[Sequence[float]]) -> NDArray[np.float64]:
    return np.asarray(np.mean(rows, axis=0), np.float64)


def cells(values: Sequence[float] | NDArray[np.float64]) -> str:
    return " | ".join(f"{value:.2f}" for value in values)


def draw(path: Path, logs: Sequence[Path]) -> None:
    """A line of pictures for each log: the centre camera's, it warped to the left camera's place, what that
    one saw, and the difference without and with the warp."""
    lines = []
    for source in logs:
        with Log(source) as log:
            geometry, taken = car_of(log), moments(log, 9)[4]
        viewpoint = Viewpoint(geometry, 320, 160)
        warped = viewpoint.view({"center": taken["center"]}, geometry.left_m["left"], 0.0)
        gaps = [cv2.absdiff(picture, taken["left"]) for picture in (taken["center"], warped.picture)]
        lines.append(np.hstack([taken["center"], warped.picture, taken["left"], *gaps]))
    if not cv2.imwrite(str(path), np.vstack(lines)):
        raise SystemExit(f"{path}: cannot be written")


if __name__ == "__main__":
    main()
