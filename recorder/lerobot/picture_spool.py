"""The pictures of one episode, kept in files until their columns are written.

A parquet file takes a row group as a whole, and an episode may be hours of driving: gigabytes, in memory.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Final, Self

import numpy as np
import pyarrow as pa

from recorder.lerobot.dataset_format import IMAGE_TYPE

_PART_BYTES: Final = 1 << 28  # of one array: Arrow counts the bytes of `binary` in 32 bits


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
