"""The files of a dataset, written episode by episode, and at the end those that describe the episodes."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Final, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from recorder.lerobot import dataset_format as form
from recorder.lerobot.dataset_format import DATA_FILE_MB, DATA_PATH, IMAGE_TYPE, MEBIBYTE, FileNumber
from recorder.lerobot.log_episodes import Sizes
from recorder.lerobot.video_files import VideoFiles

_EPISODES_AT_ONCE: Final = 64  # are kept until they are written to meta/episodes
_BYTES_A_ROW: Final = 150  # what a row has beside its pictures, at most
_PART_BYTES: Final = 1 << 28  # of one array: Arrow counts the bytes of `binary` in 32 bits


class DatasetFiles:
    """Writes the files of a dataset. As a context manager it ends them."""

    def __init__(self, root: Path, fps: int, *, has_speed: bool, is_video: bool, has_split: bool = False) -> None:
        self.root = root
        self.is_video = is_video
        self._fps = fps
        self._has_speed = has_speed
        self._has_split = has_split
        self.columns: dict[str, form.Feature] = {}  # from the first episode on
        self._schema = pa.schema([])
        self._data: DataFiles | None = None
        self._videos: list[VideoFiles] = []
        self._episodes: list[dict[str, Any]] = []
        self._episodes_writer: pq.ParquetWriter | None = None

    def begin_episode(self, sizes: Sizes) -> None:
        """To be called before anything is added of an episode."""
        if self._data is None:
            self.columns = form.features(
                sizes, has_speed=self._has_speed, is_video=self.is_video, has_split=self._has_split
            )
            self._schema = form.data_schema(self.columns)
            self._data = DataFiles(self.root, self._schema)
            cameras = sizes.items() if self.is_video else ()
            self._videos = [VideoFiles(self.root, form.image_key(camera), self._fps, s) for camera, s in cameras]
        for video in self._videos:
            video.begin_episode()

    def add_to_videos(self, pictures: Sequence[NDArray[np.uint8]]) -> None:
        """One decoded picture (height, width, 3) BGR of each camera."""
        for video, picture in zip(self._videos, pictures, strict=True):
            video.add(picture)

    def write(self, columns: Mapping[str, pa.Array | pa.ChunkedArray], size: int, about: dict[str, Any]) -> None:
        """Write an episode's columns, whose pictures have `size` bytes, and what meta/episodes has about it."""
        if self._data is None:
            raise ValueError("no episode was begun")
        table = pa.table([columns[name] for name in self._schema.names], schema=self._schema)
        number = self._data.write(table, size)
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
        with contextlib.suppress(Exception):  # the error that was raised counts; nothing of the folder stays
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
    """Write the tasks as pandas writes a table with an index, in which LeRobot finds a task by its words."""
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy_kind, "metadata": None}
        for name, (kind, numpy_kind) in kinds.items()
    ]
    pandas = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
    tasks = pa.table({"task_index": pa.array([0], pa.int64()), "task": [task]})
    pq.write_table(tasks.replace_schema_metadata({"pandas": json.dumps(pandas)}), root / form.TASKS_PATH)


class DataFiles:
    """Writes episodes one after the other; a file that would become larger than the format's size is ended before.

    An episode is always in one file, also one that is larger.
    """

    def __init__(self, root: Path, schema: pa.Schema, file_bytes: int = DATA_FILE_MB * MEBIBYTE) -> None:
        self._root = root
        self._file_bytes = file_bytes
        self._schema = schema
        self._number = FileNumber()
        self._writer: pq.ParquetWriter | None = None
        self._bytes = 0

    def write(self, episode: pa.Table, pictures_bytes: int) -> FileNumber:
        """Write an episode whose pictures have so many bytes; returns which file it is in."""
        size = pictures_bytes + len(episode) * _BYTES_A_ROW
        if self._writer is not None and self._bytes + size > self._file_bytes:
            self.close()
            self._number = self._number.next()
        if self._writer is None:
            self._writer = self._begun()
        self._writer.write_table(episode, row_group_size=len(episode))
        self._bytes += size
        return self._number

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer, self._bytes = None, 0

    def _begun(self) -> pq.ParquetWriter:
        path = self._root / self._number.path(DATA_PATH)
        path.parent.mkdir(parents=True, exist_ok=True)
        pictures = [f"{field.name}.bytes" for field in self._schema if field.type == IMAGE_TYPE]
        others = [_leaf(field) for field in self._schema if field.type != IMAGE_TYPE]
        return pq.ParquetWriter(
            path,
            self._schema,
            # a JPEG is compressed already, no two are the same, and their order means nothing
            compression=dict.fromkeys(others, "zstd") | dict.fromkeys(pictures, "none"),
            use_dictionary=[field.name for field in self._schema if field.type == pa.string()],
            write_statistics=others,
            write_page_checksum=True,
        )


def _leaf(field: pa.Field) -> str:
    """A column's name among parquet's: that of a list is its values'."""
    return f"{field.name}.list.element" if pa.types.is_fixed_size_list(field.type) else str(field.name)


class PictureSpool:
    """A file for each column of pictures. Use it as a context manager, and what it gives only within."""

    def __init__(self, folder: Path, columns: int) -> None:
        """The files are in `folder` as long as the spool is."""
        self._paths = [folder / f"spool-{number}" for number in range(columns)]
        self._files: list[BinaryIO] = []
        self._lengths: list[list[int]] = [[] for _ in self._paths]
        self._mapped: list[pa.MemoryMappedFile] = []

    def __enter__(self) -> Self:
        self._files = [path.open("wb") for path in self._paths]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for file in (*self._files, *self._mapped):
            with contextlib.suppress(OSError):  # what a full disk could not take
                file.close()
        for path in self._paths:
            path.unlink(missing_ok=True)

    def add(self, pictures: Sequence[bytes]) -> None:
        """One picture for each column. Raises OSError where the disk is full."""
        for file, lengths, picture in zip(self._files, self._lengths, pictures, strict=True):
            file.write(picture)
            lengths.append(len(picture))

    @property
    def size_bytes(self) -> int:
        return sum(map(sum, self._lengths))

    def columns(self) -> list[pa.ChunkedArray]:
        """The columns (`IMAGE_TYPE`), read from the files as they are used. To be called once, in the end."""
        columns = []
        for file, path, lengths in zip(self._files, self._paths, self._lengths, strict=True):
            file.close()
            self._mapped.append(pa.memory_map(str(path)))
            columns.append(_column(self._mapped[-1].read_buffer(), np.array(lengths, np.int64)))
        return columns


def _column(data: pa.Buffer, lengths: np.ndarray[tuple[int], np.dtype[np.int64]]) -> pa.ChunkedArray:
    ends = np.cumsum(lengths)
    cuts = np.flatnonzero(np.diff((ends - lengths) // _PART_BYTES)) + 1
    arrays = []
    for part in np.split(np.arange(len(lengths)), cuts):
        start, end = int(ends[part[0]] - lengths[part[0]]), int(ends[part[-1]])
        offsets = np.concatenate([[0], ends[part] - start]).astype(np.int32)
        buffers = [None, pa.py_buffer(offsets), data.slice(start, end - start)]
        pictures = pa.Array.from_buffers(pa.binary(), len(part), buffers)
        paths = pa.nulls(len(part), pa.string())
        arrays.append(pa.StructArray.from_arrays([pictures, paths], fields=list(IMAGE_TYPE)))
    return pa.chunked_array(arrays, IMAGE_TYPE)
