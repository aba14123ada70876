"""LeRobot's dataset format v3.0: its files, its features, and their descriptions for other libraries; the plan
of an export.

Source: lerobot 0.6.1, `datasets/utils.py`, `datasets/feature_utils.py`, `datasets/dataset_writer.py`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa

from common import Skipped
from common.car import CAMERAS, Camera
from common.location import Location
from common.steering_unit import assumed_deg
from recorder.errors import LogError
from recorder.lerobot.log_episodes import ChosenRows, log_episodes
from recorder.log.reader import Log
from recorder.log.session_car import known_max_steering_deg
from recorder.rows.row_quality import usual_step
from recorder.topics import camera_topic

VERSION: Final = "v3.0"
FILES_A_CHUNK: Final = 1000  # files in a folder `chunk-000`
DATA_FILE_MB: Final = 100
VIDEO_FILE_MB: Final = 200
MEBIBYTE: Final = 1 << 20  # the format's MB

INFO_PATH: Final = "meta/info.json"
STATS_PATH: Final = "meta/stats.json"
TASKS_PATH: Final = "meta/tasks.parquet"
CHUNK_AND_FILE: Final = "chunk-{chunk_index:03d}/file-{file_index:03d}"
EPISODES_PATH: Final = f"meta/episodes/{CHUNK_AND_FILE}.parquet"
DATA_PATH: Final = f"data/{CHUNK_AND_FILE}.parquet"
VIDEO_PATH: Final = "videos/{video_key}/" + f"{CHUNK_AND_FILE}.mp4"

STATE: Final = "observation.state"
ACTION: Final = "action"
ACTION_NAMES: Final = ("steering", "throttle", "brake")
PREVIOUS_NAMES: Final = ("previous_steering", "previous_throttle", "previous_brake")
"""Numbers of the state: the controls in force when the picture was taken. LeRobot turns a state of one number into
a scalar, and its policies then fail."""
LOG_TIME: Final = "log_time_ns"
LOG_ROW: Final = "log_row"
LOG_VEHICLE: Final = "log_vehicle"  # the log's vehicle state in 64 bits: the format's own columns have 32 bits
LOG_FINGERPRINT: Final = "log_fingerprint"
LOG_CAR: Final = "log_car"
"""A column of meta/episodes: the car of the episode's log, as JSON; empty if it is unknown."""
LOG_NOT_RECORDED: Final = "log_not_recorded"
"""A column of meta/episodes: the event about time left out on purpose before the first frame
(`recorder.log.meant_gaps`); empty without one."""
LOG_NOT_RECORDED_S: Final = "log_not_recorded_s"
"""A column of meta/episodes: the seconds of that time; exports of version 0.3 and earlier only have the event."""
SPLIT: Final = "split"
"""A column of data files and of meta/episodes: the side of an index's split, `train` or `validation`."""
REQUIRED: Final = ("timestamp", "frame_index", "episode_index", "index", "task_index")
IMAGE_TYPE: Final = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
"""An image in a data file, as the library `datasets` stores it."""


class FileNumber(NamedTuple):
    """The number of a file in its folders: `chunk-000/file-000`."""

    chunk: int = 0
    file: int = 0

    def next(self) -> FileNumber:
        if self.file + 1 < FILES_A_CHUNK:
            return FileNumber(self.chunk, self.file + 1)
        return FileNumber(self.chunk + 1, 0)

    def path(self, template: str, **names: str) -> str:
        return template.format(chunk_index=self.chunk, file_index=self.file, **names)


@dataclass(frozen=True)
class Feature:
    """One column of a dataset, as in `meta/info.json`."""

    dtype: str
    shape: tuple[int, ...]
    names: tuple[str, ...] | None = None


def image_key(camera: Camera) -> str:
    return f"observation.images.{camera}"


def features(
    sizes: Mapping[Camera, tuple[int, int]], *, has_speed: bool, is_video: bool, has_split: bool
) -> dict[str, Feature]:
    """The columns of our datasets. `sizes`: width and height of each camera's pictures."""
    images = {
        image_key(camera): Feature(
            "video" if is_video else "image", (height, width, 3), ("height", "width", "channels")
        )
        for camera, (width, height) in sizes.items()
    }
    state = ("speed_mph", *PREVIOUS_NAMES) if has_speed else PREVIOUS_NAMES
    return {
        **images,
        STATE: Feature("float32", (len(state),), state),
        ACTION: Feature("float32", (3,), ACTION_NAMES),
        "timestamp": Feature("float32", (1,)),
        **{name: Feature("int64", (1,)) for name in REQUIRED[1:]},
        LOG_TIME: Feature("int64", (1,)),
        LOG_ROW: Feature("int64", (1,)),
        LOG_VEHICLE: Feature("float64", (4,), (*ACTION_NAMES, "speed_mph")),
        LOG_FINGERPRINT: Feature("string", (1,)),
        **({SPLIT: Feature("string", (1,))} if has_split else {}),
    }


def info(
    features: Mapping[str, Feature], *, fps: int, episodes: int, frames: int, is_video: bool
) -> dict[str, Any]:
    return {
        "codebase_version": VERSION,
        "robot_type": "car",
        "fps": fps,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": FILES_A_CHUNK,
        "data_files_size_in_mb": DATA_FILE_MB,
        "video_files_size_in_mb": VIDEO_FILE_MB,
        "data_path": DATA_PATH,
        "video_path": VIDEO_PATH if is_video else None,
        "splits": {"train": f"0:{episodes}"},
        "features": {name: asdict(feature) for name, feature in features.items()},
    }


def data_schema(features: Mapping[str, Feature]) -> pa.Schema:
    """The schema of the data files, with the column descriptions for the library `datasets`."""
    columns = {name: feature for name, feature in features.items() if feature.dtype != "video"}
    described = {name: _description(feature) for name, feature in columns.items()}
    fields = [pa.field(name, _arrow_type(feature)) for name, feature in columns.items()]
    return pa.schema(fields, {"huggingface": json.dumps({"info": {"features": described}})})


def _arrow_type(feature: Feature) -> pa.DataType:
    if feature.dtype == "image":
        return IMAGE_TYPE
    kind = pa.type_for_alias(feature.dtype)
    return kind if feature.shape == (1,) else pa.list_(kind, feature.shape[0])


def _description(feature: Feature) -> dict[str, object]:
    if feature.dtype == "image":
        return {"_type": "Image"}
    value: dict[str, object] = {"dtype": feature.dtype, "_type": "Value"}
    if feature.shape == (1,):
        return value
    return {"feature": value, "length": feature.shape[0], "_type": "Sequence"}


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
