"""LeRobot's dataset format v3.0: its files, its features, and their descriptions for other libraries.

Source: lerobot 0.6.1, `datasets/utils.py`, `datasets/feature_utils.py`, `datasets/dataset_writer.py`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final, NamedTuple

import pyarrow as pa

from common.car import Camera

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
    """The content of `meta/info.json`."""
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
