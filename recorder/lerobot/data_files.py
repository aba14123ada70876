"""The data files of a dataset: `data/chunk-000/file-000.parquet`, a row group for each episode."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq

from recorder.lerobot.dataset_format import DATA_FILE_MB, DATA_PATH, IMAGE_TYPE, MEBIBYTE, FileNumber

_BYTES_A_ROW: Final = 150  # what a row has beside its pictures, at most


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
