"""Reads a LeRobot dataset of format v3: `meta/info.json`, its episodes, its data files,
and the frames of its videos.

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
from typing import TYPE_CHECKING, Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from common.closeable import Closeable
from common.errors import printable
from common.untrusted import open_regular, read_bounded
from recorder.errors import RecordingError, readable
from recorder.lerobot.dataset_format import INFO_PATH, VERSION, VIDEO_PATH, Feature, FileNumber
from recorder.pictures.picture_size import MAX_PIXELS
from recorder.sources.compressed_video import jpeg_of

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer

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


_MAX_S: Final = 1e9  # in a video: thirty years


class CameraVideos(Closeable):
    """The videos of one camera, read from the first row to the last."""

    def __init__(self, dataset: LeRobotFolder, key: str) -> None:
        """Raises RecordingError if a video is missing."""
        import av  # slow

        self._av = av
        if dataset.video_path != VIDEO_PATH:
            raise RecordingError(
                f"{dataset.root}: videos in {printable(dataset.video_path[:100])!r}; expected {VIDEO_PATH}"
            )
        prefix = f"videos/{key}"
        columns = [
            "episode_index",
            *(f"{prefix}/{name}" for name in ("chunk_index", "file_index", "from_timestamp")),
        ]
        table = dataset.episode_table(columns)
        self._places: dict[int, tuple[Path, float]] = {}
        paths: dict[tuple[int, int], Path] = {}
        for row in table.to_pylist():
            episode, chunk, file, start_s = (row[name] for name in columns)
            try:
                number = int(chunk), int(file)
                if number not in paths:
                    relative = FileNumber(*number).path(VIDEO_PATH, video_key=key)
                    paths[number] = dataset.file(dataset.root / relative)
                    if not paths[number].is_file():
                        raise RecordingError(
                            f"{dataset.root / relative}: not there; download the dataset with its videos"
                        )
                if not abs(start_s) < _MAX_S:
                    raise ValueError(start_s)
                self._places[int(episode)] = paths[number], float(start_s)
            except (TypeError, ValueError, OverflowError):
                raise RecordingError(f"{dataset.root}: meta/episodes does not have the places of videos") from None
        self._tolerance_s = 0.5 / dataset.fps
        self._episode = -1
        self._path: Path | None = None
        self._container: InputContainer | None = None
        self._frames: Iterator[VideoFrame] = iter(())
        self._next: VideoFrame | None = None

    def jpeg(self, episode: int, time_s: float) -> bytes | None:
        """The frame of an episode at a time, encoded anew; None if there is none.

        Call it with ascending times of each episode. Raises RecordingError if a video cannot be decoded.
        """
        if episode not in self._places:
            return None
        path, start_s = self._places[episode]
        try:
            if episode != self._episode:
                self._go_to(episode, path, start_s)
            wanted_s = start_s + time_s
            while self._next is None or (self._next.time or 0.0) < wanted_s - self._tolerance_s:
                self._next = next(self._frames, None)
                if self._next is None:
                    return None
            if abs((self._next.time or 0.0) - wanted_s) > self._tolerance_s:
                return None
            return jpeg_of(self._next)
        except (self._av.FFmpegError, ValueError) as error:
            raise RecordingError(
                f"{path}: the video cannot be decoded ({printable(str(error)[:200])}); download it again"
            ) from None

    def close(self) -> None:
        if self._container is not None:
            self._container.close()
            self._container = None

    def _go_to(self, episode: int, path: Path, start_s: float) -> None:
        if path != self._path or self._container is None:
            self.close()
            # the format is given: FFmpeg's guess may follow a list of other files that is named .mp4
            self._container = self._av.open(f"file:{path}", "r", format="mp4")
            self._path = path
        if not self._container.streams.video:
            raise RecordingError(f"{path}: no video in it; download it again")
        stream: Any = self._container.streams.video[0]
        if not 0 < stream.width * stream.height <= MAX_PIXELS:
            raise RecordingError(f"{path}: a video of {stream.width} x {stream.height} pixels is not a camera's")
        self._container.seek(max(0, int(start_s / stream.time_base) - 1), backward=True, stream=stream)
        self._frames = self._container.decode(stream)
        self._next, self._episode = None, episode
