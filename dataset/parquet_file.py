"""Parquet files with metadata on what they were made from."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from common import atomic_file

METADATA_KEY: Final = b"bc.index"
"""The key of that metadata in each parquet file of an index."""


METADATA_MOST_BYTES: Final = 1 << 30
"""Of 100,000 sessions it has 130 MB; Parquet's readers stop at 100 by default."""


def read_schema(source: Path | pa.BufferReader) -> pa.Schema:
    """The columns of a parquet file, with its metadata, however many sessions that lists."""
    with pq.ParquetFile(source, thrift_string_size_limit=METADATA_MOST_BYTES) as file:
        return file.schema_arrow


def read_columns(source: Path, columns: Sequence[str] | None = None, **options: Any) -> pa.Table:
    """Some columns of a parquet file, or all, however many sessions its metadata lists. `options` are those of
    `pyarrow.parquet.read_table`. Raises what that does."""
    return pq.read_table(source, columns=columns, thrift_string_size_limit=METADATA_MOST_BYTES, **options)


def read_metadata(path: Path) -> dict[str, Any] | None:
    """The metadata that one of our parquet files carries; None if it is missing, damaged or not ours."""
    try:
        stored = read_schema(path).metadata or {}
        loaded = json.loads(stored[METADATA_KEY])
    except (OSError, ValueError, KeyError, pa.ArrowException, RecursionError):
        return None
    return loaded if isinstance(loaded, dict) else None


def write_table(path: Path, table: pa.Table, metadata: dict[str, Any]) -> None:
    """Write a parquet file whole, or leave the old one. Same table and metadata: same bytes."""
    stored = {METADATA_KEY: json.dumps(metadata, sort_keys=True).encode()}
    with atomic_file(path, overwrite=True) as part:
        pq.write_table(table.replace_schema_metadata(stored), part, compression="zstd", write_page_checksum=True)
