"""Reads a LeRobot dataset of format v3: `meta/info.json`, its episodes, and its data files.

A dataset is untrusted: it is checked before use. Links are followed only within the dataset, and into the cache of
Hugging Face's own programs.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from common.errors import printable
from common.untrusted import open_regular, read_bounded
from recorder.errors import RecordingError, readable
from recorder.lerobot.dataset_format import INFO_PATH, VERSION, Feature

MAX_EPISODES: Final = 10_000_000
MAX_INFO_BYTES: Final = 1 << 24
BATCH_ROWS: Final = 64
_CONVERT: Final = "LeRobot converts it: `python -m lerobot.scripts.convert_dataset_v21_to_v30 --repo-id=YOU/NAME`"


@dataclass(frozen=True)
class LeRobotFolder:
    """A dataset, as `meta/info.json` describes it."""

    root: Path
    version: str
    fps: float
    episodes: int
    frames: int
    robot: str
    features: Mapping[str, Feature]
    video_path: str

    @property
    def image_keys(self) -> list[str]:
        """The features with pictures in three colours."""
        return [
            name
            for name, feature in self.features.items()
            if feature.dtype in ("image", "video") and len(feature.shape) == 3 and 3 in feature.shape
        ]

    def file(self, path: Path) -> Path:
        """A file of the dataset, to be opened. Raises RecordingError for a link out of it."""
        real = Path(os.path.realpath(path))
        places = [Path(os.path.realpath(self.root))]
        if self.root.absolute().parent.name == "snapshots":  # Hugging Face's layout of downloads
            places.append(Path(os.path.realpath(self.root.absolute().parent.parent / "blobs")))
        if not any(real.is_relative_to(place) for place in places):
            raise RecordingError(
                f"{path}: a link out of the dataset is not followed; copy its target into the dataset"
            )
        return real

    def data_files(self) -> list[Path]:
        """Raises RecordingError if there is none."""
        paths = sorted((self.root / "data").glob("*/*.parquet"))
        if not paths:
            raise RecordingError(f"{self.root / 'data'}: no parquet file in it; was the dataset downloaded whole?")
        return paths

    def rows(self, path: Path, columns: Sequence[str]) -> Iterator[pa.RecordBatch]:
        """Columns of a parquet file, some rows at a time. Raises RecordingError for a damaged file."""
        with self._parquet(path) as file:
            stored = set(file.schema_arrow.names)
            if missing := [name for name in columns if name not in stored]:
                raise RecordingError(f"{path}: no column {missing[0]!r}, which {INFO_PATH} promises")
            yield from file.iter_batches(BATCH_ROWS, columns=list(columns), use_threads=False)

    def episode_table(self, columns: Sequence[str]) -> pa.Table:
        """Columns of `meta/episodes`, an episode a row. Raises RecordingError if one is missing."""
        files = sorted((self.root / "meta/episodes").glob("*/*.parquet"))
        batches = [batch for path in files for batch in self.rows(path, columns)]
        if not batches:
            raise RecordingError(f"{self.root / 'meta/episodes'}: no episode is described there")
        return pa.Table.from_batches(batches)

    @contextlib.contextmanager
    def _parquet(self, path: Path) -> Iterator[pq.ParquetFile]:
        try:
            with open_regular(self.file(path)) as stream:
                yield pq.ParquetFile(stream, page_checksum_verification=True)
        except (OSError, pa.ArrowException) as error:
            why = getattr(error, "strerror", None) or str(error).partition("\n")[0]
            raise RecordingError(
                f"{path}: cannot be read as parquet ({printable(why[:200])}); cut off? Download it again"
            ) from None


def open_dataset(folder: Path) -> LeRobotFolder:
    """Raises RecordingError for anything but a dataset of format v3."""
    path = folder / INFO_PATH
    try:
        with readable(path):
            loaded = json.loads(read_bounded(path, MAX_INFO_BYTES))
    except (ValueError, RecursionError):
        raise RecordingError(f"{path}: not JSON; download the dataset again") from None
    try:
        return _dataset(folder, loaded)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:  # 1e999 is no count
        raise RecordingError(f"{path}: not as LeRobot writes it ({printable(repr(error)[:200])})") from None


def _dataset(folder: Path, info: dict[str, Any]) -> LeRobotFolder:
    version = str(info["codebase_version"])
    if not version.startswith("v3."):
        advice = f". {_CONVERT}" if version == "v2.1" else ""
        raise RecordingError(
            f"{folder}: a LeRobot dataset of format {printable(version[:40])}; expected {VERSION}{advice}"
        )
    features = {
        str(name): Feature(str(stored["dtype"]), tuple(map(int, stored["shape"])), _names(stored.get("names")))
        for name, stored in info["features"].items()
    }
    dataset = LeRobotFolder(
        folder,
        version,
        float(info["fps"]),
        int(info["total_episodes"]),
        int(info["total_frames"]),
        str(info.get("robot_type") or ""),
        features,
        str(info.get("video_path") or ""),
    )
    if not (0 < dataset.fps < 10_000 and 0 <= dataset.episodes <= MAX_EPISODES and dataset.frames >= 0):
        raise ValueError("fps, total_episodes or total_frames out of range")
    if any("/" in name or "\\" in name or name in ("", ".", "..") for name in features):
        raise ValueError("a feature with a slash in its name")
    return dataset


def _names(stored: object) -> tuple[str, ...] | None:
    """The names of a feature's numbers: a list, the only list in a dict, as in {"axes": ["x", "y"]}, or the keys
    of {"x": 0, "y": 1}."""
    if isinstance(stored, dict):
        place = {str(at): name for name, at in stored.items()}
        if place.keys() == set(map(str, range(len(stored)))):
            stored = [place[str(at)] for at in range(len(stored))]
    if isinstance(stored, dict) and len(stored) == 1:
        (stored,) = stored.values()
    if isinstance(stored, list) and all(isinstance(name, str) for name in stored):
        return tuple(stored)
    return None
