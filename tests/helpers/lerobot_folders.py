"""Small LeRobot datasets of others, written without any of the toolkit's code."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

IMAGE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])


def image_feature() -> dict[str, Any]:
    return {"dtype": "image", "shape": [32, 64, 3], "names": ["height", "width", "channels"]}


def numbers_feature(names: object, width: int) -> dict[str, Any]:
    return {"dtype": "float32", "shape": [width], "names": names}


def write_dataset(
    folder: Path,
    features: Mapping[str, dict[str, Any]],
    columns: Mapping[str, Sequence[Any]],
    lengths: Sequence[int],
    **info: Any,
) -> Path:
    """Episodes of these lengths, 20 frames a second, all in one file. `info` changes what meta/info.json says."""
    frames = [frame for length in lengths for frame in range(length)]
    required = {
        "timestamp": pa.array([frame / 20 for frame in frames], pa.float32()),
        "frame_index": frames,
        "episode_index": [episode for episode, length in enumerate(lengths) for _ in range(length)],
        "index": list(range(len(frames))),
        "task_index": [0] * len(frames),
    }
    typed = {
        name: pa.array(values, IMAGE) if features[name]["dtype"] == "image" else _numbers(features[name], values)
        for name, values in columns.items()
    }
    (folder / "data/chunk-000").mkdir(parents=True)
    (folder / "meta").mkdir()
    pq.write_table(pa.table({**required, **typed}), folder / "data/chunk-000/file-000.parquet")
    reported = {
        "codebase_version": "v3.0",
        "fps": 20,
        "robot_type": "a_car",
        "features": {
            **features,
            **{
                name: {"dtype": "float32" if name == "timestamp" else "int64", "shape": [1], "names": None}
                for name in required
            },
        },
        "total_episodes": len(lengths),
        "total_frames": len(frames),
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    }
    (folder / "meta/info.json").write_text(json.dumps({**reported, **info}))
    return folder


def as_image(data: bytes) -> dict[str, Any]:
    return {"bytes": data, "path": "frame.jpg"}


def _numbers(feature: Mapping[str, Any], values: Sequence[Any]) -> pa.Array:
    kind = pa.type_for_alias(feature["dtype"])
    return pa.array(values, kind if feature["shape"] == [1] else pa.list_(kind, feature["shape"][0]))
