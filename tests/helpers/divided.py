"""Divided samples as one file, which is how they are compared."""

from __future__ import annotations

import shutil
from pathlib import Path

import pyarrow.parquet as pq

from dataset.samples.samples_format import sample_files


def in_one_file(index: Path, to: Path) -> Path:
    """A copy of an index with the same samples, not divided, beside it: its logs lie where they did."""
    table = pq.ParquetDataset(sample_files(index)).read()
    shutil.copytree(index, to)
    shutil.rmtree(to / "samples")
    about = pq.read_schema(to / "samples.parquet").metadata[b"bc.index"]
    changed = about.replace(b'"parts"', b'"others"').replace(b'"format": 6', b'"format": 5')
    pq.write_table(table.replace_schema_metadata({b"bc.index": changed}), to / "samples.parquet")
    return to
