"""The plan of an export, made before writing: cameras, rate and speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from common import Skipped
from common.car import CAMERAS, Camera
from common.location import Location
from common.steering_unit import assumed_deg
from recorder.errors import LogError
from recorder.lerobot.dataset_format import LOG_TIME, LOG_VEHICLE, STATE
from recorder.lerobot.log_episodes import ChosenRows, log_episodes
from recorder.log.reader import Log
from recorder.log.session_car import known_max_steering_deg
from recorder.rows.row_quality import usual_step
from recorder.topics import camera_topic

RATES_DIFFER: Final = 1.2
"""A notice is shown if sessions' rates differ by this factor: the format has one rate for all."""


@dataclass(frozen=True)
class ExportPlan:
    cameras: tuple[Camera, ...]
    has_speed: bool
    """Every row has a speed."""
    rate_hz: float
    max_steering_deg: float | None  # of the front wheels at steering 1; None: unknown
    rows: int
    """The most frames."""
    notices: tuple[str, ...]

    @property
    def fps(self) -> int:
        """The rate as a whole number, as the format requires."""
        return max(1, round(self.rate_hz))


def plan_export(
    paths: Sequence[Location],
    chosen: Mapping[Location, ChosenRows] | None = None,
    wanted: Sequence[Camera] = CAMERAS,
) -> ExportPlan:
    """The plan for the logs at `paths`, or for the `chosen` rows of each, with pictures of the `wanted` cameras.

    Raises LogError if a log cannot be read, if no camera is in all logs, or if their steering scales differ.
    """
    cameras, notices = _cameras(paths, wanted)
    steps, rates, row_count, has_speeds, degrees = [np.zeros(0, np.int64)], {}, 0, [], set[float | None]()
    for path in paths:
        with Log(path, shows_progress=True) as log:
            taken = log_episodes(log, cameras, Skipped(), None if chosen is None else chosen[path])
            degrees.add(known_max_steering_deg(log))
        row_count += len(taken.states.row)
        log_steps = taken.steps_ns[taken.steps_ns > 0]
        if len(log_steps):
            steps.append(log_steps)
            rates[path.name] = 1e9 / usual_step(log_steps)
        if len(taken.states.row):
            has_speeds.append(bool(np.isfinite(taken.states.speed_mph).all()))
    rate_hz = 1e9 / usual_step(np.concatenate(steps)) if rates else 1.0
    if rates and max(rates.values()) > RATES_DIFFER * min(rates.values()):
        listed = ", ".join(f"{rate:.1f} in {name}" for name, rate in rates.items())
        notices.append(
            f"rows a second differ ({listed}); the dataset says {rate_hz:.0f}, its {LOG_TIME} are right"
        )
    if any(has_speeds) and not all(has_speeds):
        notices.append(f"not every row has a speed: it is in {LOG_VEHICLE}, and {STATE} is without it")
    if len(assumed := {assumed_deg(max_deg) for max_deg in degrees}) > 1:
        listed = " and ".join(f"{max_deg:g}" for max_deg in sorted(assumed))
        raise LogError(
            f"{', '.join(map(str, paths))}: at steering 1, wheels turn by {listed} degrees, but a dataset has one"
            " scale; export them one by one"
        )
    return ExportPlan(
        cameras,
        bool(has_speeds) and all(has_speeds),
        rate_hz,
        None if None in degrees else degrees.pop(),
        row_count,
        tuple(notices),
    )


def _cameras(paths: Sequence[Location], wanted: Sequence[Camera]) -> tuple[tuple[Camera, ...], list[str]]:
    """The wanted cameras that all logs have, and lines about the others."""
    having: dict[Camera, list[str]] = {camera: [] for camera in CAMERAS if camera in wanted}
    for path in paths:
        with Log(path) as log:
            for camera in having:
                if log.counts.get(camera_topic(camera)):
                    having[camera].append(path.name)
    cameras = tuple(camera for camera in having if len(having[camera]) == len(paths))
    if not cameras:
        why = "they have no camera in common; export them one by one" if len(paths) > 1 else "no camera's pictures"
        raise LogError(f"{', '.join(map(str, paths))}: {why}")
    notices = [
        f"the {camera} camera is left out: only {', '.join(names)} {'has' if len(names) == 1 else 'have'} its"
        " pictures, and every frame of a dataset needs them"
        for camera, names in having.items()
        if names and camera not in cameras
    ]
    return cameras, notices
