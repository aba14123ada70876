"""Parquet files with metadata about their sources."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from common import atomic_file

METADATA_KEY: Final = b"bc.index"  # the key of the metadata in each parquet file of an index

MAX_METADATA_BYTES: Final = 1 << 30
"""The metadata of 100,000 sessions has 130 MB; by default, Parquet's readers accept at most 100 MB."""


def read_schema(source: Path | pa.BufferReader) -> pa.Schema:
    """The schema of a parquet file, with its metadata of any number of sessions."""
    with pq.ParquetFile(source, thrift_string_size_limit=MAX_METADATA_BYTES) as file:
        return file.schema_arrow


def read_columns(source: Path, columns: Sequence[str] | None = None, **options: Any) -> pa.Table:
    """Read some or all columns of a parquet file, with metadata of any number of sessions. `options` are those of
    `pyarrow.parquet.read_table`. Raises pyarrow's errors."""
    return pq.read_table(source, columns=columns, thrift_string_size_limit=MAX_METADATA_BYTES, **options)


def read_metadata(path: Path) -> dict[str, Any] | None:
    """The index's metadata in a parquet file; None if the file is missing, damaged or of another program."""
    try:
        stored = read_schema(path).metadata or {}
        loaded: dict[str, Any] = json.loads(stored[METADATA_KEY])
    except (OSError, ValueError, KeyError, pa.ArrowException):
        return None
    return loaded


def write_table(path: Path, table: pa.Table, metadata: dict[str, Any]) -> None:
    """Write a parquet file atomically. The same table and metadata give the same bytes."""
    stored = {METADATA_KEY: json.dumps(metadata, sort_keys=True).encode()}
    with atomic_file(path, overwrite=True) as part:
        pq.write_table(table.replace_schema_metadata(stored), part, compression="zstd", write_page_checksum=True)
