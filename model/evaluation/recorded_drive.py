"""Driving a recording: a network steers, and sees the recorded pictures from where it has brought the car.

bc-eval RUN --on SESSION

The way, the speed and the pictures are the recording's. A network that steers as the person did stays on the
recorded line; one that does not leaves it, sees that (`dataset/viewpoint.py`), and may come back. Farther from the
line than a stated distance is an intervention: the car is put back (Bojarski et al. 2016, section 7.1).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from common import Skipped
from common.autonomy import autonomy_percent
from common.car import MPS_PER_MPH
from common.location import Location
from common.progress import progress_bar
from dataset.errors import DatasetError
from dataset.loader.log_views import LogViews
from dataset.picture_spec import ORIGINAL, PictureSpec
from dataset.preprocessing import Image
from dataset.recorded_line import SHORTEST_S, SLOW_MPH, CarBesideLine, DrivableStretch
from model.errors import RunError

DEPARTURE_M: Final = 1.0

Predict = Callable[[Image], float]
"""A function from the crop (height, width, 3) BGR that a network sees to steering, -1 (left) .. 1 (right), clamped
to that range."""


@dataclass(frozen=True)
class DrivenRow:
    """A row that was driven."""

    row: int
    steering: float  # of the network, -1 .. 1
    left_m: float  # of the recorded line
    turn_rad: float  # from its direction, positive to the left
    known: float  # how much of what the network saw is known, 0 .. 1; the rest was filled up


@dataclass(frozen=True)
class RecordedDrive:
    """A network's drive of a recording."""

    session: str
    log: Location
    departure_m: float
    rows: int  # that were driven
    rows_left_out: int  # borders: standing, manoeuvring, hits, gaps, rows without a picture or tagged `exclude`
    stretches: int  # between borders
    driven_s: float
    distance_m: float  # along the recorded line
    interventions: int
    mean_offset_m: float  # of the distance from the line, over rows
    max_offset_m: float
    known_share: float
    moments: list[DrivenRow] = field(repr=False)
    skipped: Skipped = field(repr=False)
    notice: str = ""  # that the log was never finished

    @property
    def autonomy_percent(self) -> float:
        return autonomy_percent(self.interventions, self.driven_s)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        left_out = ("log", "moments", "skipped", "notice")
        return {
            "log": str(self.log),
            **{name: value for name, value in vars(self).items() if name not in left_out},
            "autonomy_percent": self.autonomy_percent,
            "skipped": dict(self.skipped.counts),
        }


def drive_recording(
    predict: Predict,
    log: Path | str,
    *,
    departure_m: float = DEPARTURE_M,
    car: str = "auto",
    picture: PictureSpec = ORIGINAL,
) -> RecordedDrive:
    """Let a network drive a log, finished or not, with a progress bar. The same network and log, the same drive.
    `picture` is what it sees.

    Raises LogError for a damaged log or damaged tags, RecordingError where its car is unknown,
    DatasetError if nothing of it can be driven, RunError if the network predicts NaN.
    """
    with LogViews(log, car, picture) as views:
        return drive_views(predict, views, departure_m)


def drive_views(predict: Predict, views: LogViews, departure_m: float = DEPARTURE_M) -> RecordedDrive:
    """`drive_recording` of a log that is open."""
    if not (departure_m > 0 and math.isfinite(departure_m)):
        raise ValueError(f"departure_m must be above 0, not {departure_m}")
    stretches = views.stretches
    drive = _Drive(views, predict, departure_m)
    with progress_bar() as bar:
        task = bar.add_task(
            f"driving {views.session}", total=sum(each.end - each.first for each in stretches), note=""
        )
        for each in stretches:
            drive.stretch(each, lambda: bar.advance(task))
    if not drive.driven_s:
        raise DatasetError(
            f"{views.path}: nothing in it can be driven: {SHORTEST_S:g} seconds at {SLOW_MPH:g} mph or more were"
            " expected, with whole pictures of the centre camera, steering in -1..1 and no tag exclude;"
            " `bc-log info` shows what it holds"
        )
    offsets_m = np.abs([moment.left_m for moment in drive.moments])
    return RecordedDrive(
        session=views.session,
        log=views.path,
        departure_m=departure_m,
        rows=len(drive.moments),
        rows_left_out=len(views.states.row) - len(drive.moments),
        stretches=len(stretches),
        driven_s=drive.driven_s,
        distance_m=drive.distance_m,
        interventions=drive.interventions,
        mean_offset_m=float(offsets_m.mean()),
        max_offset_m=float(offsets_m.max()),
        known_share=float(np.mean([moment.known for moment in drive.moments])),
        moments=drive.moments,
        skipped=views.skipped,
        notice=views.notice,
    )


class _Drive:
    """The drive, as far as it has come."""

    def __init__(self, views: LogViews, predict: Predict, departure_m: float) -> None:
        self._views = views
        self._predict = predict
        self._departure_m = departure_m
        self.moments: list[DrivenRow] = []
        self.interventions = 0
        self.driven_s = 0.0
        self.distance_m = 0.0

    def stretch(self, stretch: DrivableStretch, advance: Callable[[], object]) -> None:
        states = self._views.states
        rows = slice(stretch.first, stretch.end)
        time_ns, steering = states.time_ns[rows].tolist(), states.steering[rows].tolist()
        speed_mps = (states.speed_mph[rows] * MPS_PER_MPH).tolist()
        car = CarBesideLine(self._views.geometry)
        car.put_on_line(steering[0])
        for here in range(len(steering)):
            advance()
            view = self._views.crop_from(stretch.first + here, car.left_m, car.turn_rad)
            if view is None:  # as a gap: there is nothing to steer by
                if here + 1 < len(steering):
                    car.put_on_line(steering[here + 1])
                continue
            crop, known = view
            answer = self._predict(crop)
            if not math.isfinite(answer):
                raise RunError("the network predicts something that is not a number; train it again")
            answer = min(1.0, max(-1.0, answer))
            row = int(states.row[stretch.first + here])
            self.moments.append(DrivenRow(row, answer, car.left_m, car.turn_rad, known))
            if here + 1 == len(steering):
                break
            seconds = (time_ns[here + 1] - time_ns[here]) / 1e9
            speeds = speed_mps[here], speed_mps[here + 1]
            car.follow(answer, steering[here], speeds, seconds)
            self.driven_s += seconds
            self.distance_m += seconds * sum(speeds) / 2
            if abs(car.left_m) > self._departure_m:
                self.interventions += 1
                car.put_on_line(steering[here + 1])
