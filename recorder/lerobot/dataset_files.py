"""Writes the files of a dataset: data and videos episode by episode, and at the end the files that describe the
episodes, and its card, the README.md."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from common import UserError
from common.markdown import rendered
from common.versions import version_of
from recorder.lerobot import dataset_format as form
from recorder.lerobot.dataset_format import PREVIOUS_NAMES, SPLIT, STATE, ExportPlan
from recorder.lerobot.log_episodes import Sizes

if TYPE_CHECKING:
    from av.container import OutputContainer

_EPISODES_AT_ONCE: Final = 64  # written to meta/episodes together
_BYTES_A_ROW: Final = 150  # of a row without its pictures, at most


class DatasetFiles:
    """Writes the files of a dataset. As a context manager, it finishes them."""

    def __init__(self, root: Path, plan: ExportPlan, *, is_video: bool, has_split: bool) -> None:
        self.root = root
        self.is_video = is_video
        self._plan = plan
        self._has_split = has_split
        self.columns: dict[str, form.Feature] = {}  # from the first episode on
        self._data: DataFiles | None = None
        self._videos: list[VideoFiles] = []
        self._episodes: list[dict[str, Any]] = []
        self._episodes_writer: pq.ParquetWriter | None = None

    def begin_episode(self, sizes: Sizes, frames: int, pictures_bytes: int) -> None:
        """Begin an episode. `frames` and `pictures_bytes` are upper limits."""
        if self._data is None:
            self.columns = form.features(
                sizes, has_speed=self._plan.has_speed, is_video=self.is_video, has_split=self._has_split
            )
            self._data = DataFiles(self.root, form.data_schema(self.columns))
            videos = {form.image_key(camera): size for camera, size in sizes.items()} if self.is_video else {}
            self._videos = [VideoFiles(self.root, key, self._plan.fps, size) for key, size in videos.items()]
        self._data.begin_episode(frames, 0 if self.is_video else pictures_bytes)
        for video in self._videos:
            video.begin_episode()

    def add_to_videos(self, pictures: Sequence[NDArray[np.uint8]]) -> None:
        """Add a decoded picture (height, width, 3) BGR of each camera."""
        for video, picture in zip(self._videos, pictures, strict=True):
            video.add(picture)

    def write(self, columns: Mapping[str, pa.Array]) -> None:
        assert self._data is not None  # noqa: S101
        self._data.write(columns)

    def end_episode(self, about: dict[str, Any]) -> None:
        assert self._data is not None  # noqa: S101
        number = self._data.number
        places: dict[str, Any] = {"data/chunk_index": number.chunk, "data/file_index": number.file}
        for video in self._videos:
            places |= video.episode_columns()
        self._episodes.append({**about, **places, "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0})
        if len(self._episodes) >= _EPISODES_AT_ONCE:
            self._write_episodes()

    def close(self) -> None:
        for files in (self._data, *self._videos):
            if files is not None:
                files.close()
        self._write_episodes()
        if self._episodes_writer is not None:
            self._episodes_writer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
            return
        with contextlib.suppress(Exception):  # the first exception counts; the folder is removed
            self.close()

    def _write_episodes(self) -> None:
        if not self._episodes:
            return
        table = pa.Table.from_pylist(self._episodes)
        if self._episodes_writer is None:
            path = self.root / form.FileNumber().path(form.EPISODES_PATH)
            path.parent.mkdir(parents=True)
            self._episodes_writer = pq.ParquetWriter(path, table.schema, write_page_checksum=True)
        self._episodes_writer.write_table(table)
        self._episodes = []


def write_json(path: Path, content: object) -> None:
    path.write_text(json.dumps(content, indent=4, allow_nan=False) + "\n", encoding="utf-8")


def write_tasks(root: Path, task: str) -> None:
    """Write the tasks as a pandas table whose index is the task's text, as LeRobot reads it."""
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy_kind, "metadata": None}
        for name, (kind, numpy_kind) in kinds.items()
    ]
    pandas = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
    tasks = pa.table({"task_index": pa.array([0], pa.int64()), "task": [task]})
    pq.write_table(tasks.replace_schema_metadata({"pandas": json.dumps(pandas)}), root / form.TASKS_PATH)


class DataFiles:
    """Writes the frames of episodes, one after the other.

    Each episode is in one file. It begins a new file if the old one might become larger than the format's size.
    """

    def __init__(self, root: Path, schema: pa.Schema, file_bytes: int = form.DATA_FILE_MB * form.MEBIBYTE) -> None:
        self.number = form.FileNumber()  # of the file that the episode is in
        self._root = root
        self._file_bytes = file_bytes
        self._schema = schema
        self._writer: pq.ParquetWriter | None = None
        self._bytes = 0

    def begin_episode(self, frames: int, pictures_bytes: int) -> None:
        """Begin an episode. `frames` and `pictures_bytes` are upper limits."""
        size = pictures_bytes + frames * _BYTES_A_ROW
        if self._writer is not None and self._bytes + size > self._file_bytes:
            self.close()
            self.number = self.number.next()
        if self._writer is None:
            self._writer = self._begun()
        self._bytes += size

    def write(self, columns: Mapping[str, pa.Array]) -> None:
        assert self._writer is not None  # noqa: S101
        table = pa.table([columns[name] for name in self._schema.names], schema=self._schema)
        self._writer.write_table(table, row_group_size=len(table))

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer, self._bytes = None, 0

    def _begun(self) -> pq.ParquetWriter:
        path = self._root / self.number.path(form.DATA_PATH)
        path.parent.mkdir(parents=True, exist_ok=True)
        pictures = [f"{field.name}.bytes" for field in self._schema if field.type == form.IMAGE_TYPE]
        others = [_leaf(field) for field in self._schema if field.type != form.IMAGE_TYPE]
        return pq.ParquetWriter(
            path,
            self._schema,
            # JPEGs are compressed already, and have no dictionary or order
            compression=dict.fromkeys(others, "zstd") | dict.fromkeys(pictures, "none"),
            use_dictionary=[field.name for field in self._schema if field.type == pa.string()],
            write_statistics=others,
            write_page_checksum=True,
        )


def _leaf(field: pa.Field) -> str:
    """A column's name in parquet; a list has the name of its values."""
    return f"{field.name}.list.element" if pa.types.is_fixed_size_list(field.type) else str(field.name)


CODEC: Final = "libx264"
# g: every other picture is a key frame, as in LeRobot's videos; bf: pictures are stored in order
_ENCODER: Final = {"preset": "veryfast", "crf": "23", "g": "2", "bf": "0"}
_BT601: Final = 6  # SMPTE 170M, which swscale converts to


class VideoFiles:
    """Writes the pictures of one camera. An episode begins a new file if the old one has the format's size."""

    def __init__(self, root: Path, key: str, fps: int, size: tuple[int, int]) -> None:
        """`size`: width and height. Raises UserError for an odd size."""
        import av  # slow

        self._av = av
        if size[0] % 2 or size[1] % 2:
            raise UserError(f"--video: pictures of {size[0]} x {size[1]} pixels: H.264 needs even numbers")
        self._root, self._key, self._fps, self._size = root, key, fps, size
        self._number = form.FileNumber()
        self._container: OutputContainer | None = None
        self._stream: Any = None
        self._path = root
        self._frames = self._first = 0

    def begin_episode(self) -> None:
        if self._container is not None and self._path.stat().st_size > form.VIDEO_FILE_MB * form.MEBIBYTE:
            self.close()
            self._number = self._number.next()
        if self._container is None:
            self._begin_file()
        self._first = self._frames

    def add(self, bgr: NDArray[np.uint8]) -> None:
        frame = self._av.VideoFrame.from_ndarray(bgr, format="bgr24")
        frame.pts, frame.time_base = self._frames, Fraction(1, self._fps)
        if self._container is None:
            raise ValueError("no episode was begun")
        self._container.mux(self._stream.encode(frame))
        self._frames += 1

    def episode_columns(self) -> dict[str, float | int]:
        """The place of the last episode, for `meta/episodes`."""
        return {
            f"videos/{self._key}/chunk_index": self._number.chunk,
            f"videos/{self._key}/file_index": self._number.file,
            f"videos/{self._key}/from_timestamp": self._first / self._fps,
            f"videos/{self._key}/to_timestamp": self._frames / self._fps,
        }

    def close(self) -> None:
        if self._container is not None:
            self._container.mux(self._stream.encode())
            self._container.close()
            self._container = None

    def _begin_file(self) -> None:
        self._path = self._root / self._number.path(form.VIDEO_PATH, video_key=self._key)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        # FFmpeg takes what is before a colon in a name for a protocol
        self._container = self._av.open(f"file:{self._path}", "w", format="mp4")
        self._stream = self._container.add_stream(CODEC, rate=self._fps, options=_ENCODER)
        self._stream.width, self._stream.height = self._size
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.time_base = Fraction(1, self._fps)
        self._stream.codec_context.colorspace = _BT601
        self._frames = 0


def video_info(fps: int, size: tuple[int, int]) -> dict[str, object]:
    """The entries of a video in `meta/info.json`, as lerobot's `datasets/video_utils.py` writes them."""
    return {
        "video.height": size[1],
        "video.width": size[0],
        "video.codec": "h264",
        "video.pix_fmt": "yuv420p",
        "video.fps": fps,
        "video.channels": 3,
        "video.g": int(_ENCODER["g"]),
        "video.crf": int(_ENCODER["crf"]),
        "video.preset": _ENCODER["preset"],
        "has_audio": False,
        "is_depth_map": False,
    }


CARD_PATH: Final = "README.md"
NO_LICENCE: Final = "not stated: ask whoever recorded it before you use it"


@dataclass(frozen=True)
class CardSession:
    name: str
    fingerprint: str
    session: Mapping[str, str]  # the log's metadata about its origin
    rows: int
    episodes: int
    excluded: int

    @property
    def origin(self) -> str:
        named = ("source", "track", "driver", "run", "recording")
        parts = [f"{name}: {self.session[name]}" for name in named if self.session.get(name)]
        return ", ".join(parts) or "unknown"


def card(
    info: Mapping[str, Any],
    sessions: Sequence[CardSession],
    plan: ExportPlan,
    *,
    task: str,
    licence: str | None,
    picture: str,
) -> str:
    """The text of a card. `picture`: the file name of an example."""
    max_deg = plan.max_steering_deg
    return rendered(
        "recorder",
        "dataset_card.md.jinja",
        info=info,
        sessions=sessions,
        task=task,
        licence=licence,
        no_licence=NO_LICENCE,
        picture=picture,
        rate_hz=plan.rate_hz,
        cameras=", ".join(name for name in info["features"] if name.startswith("observation.images.")),
        full_lock="an unknown angle" if max_deg is None else f"{max_deg:g} degrees",
        has_speed="speed_mph" in info["features"][STATE]["names"],
        has_split=SPLIT in info["features"],
        previous=", ".join(f"`{name}`" for name in PREVIOUS_NAMES),
        version=version_of(),
    )
