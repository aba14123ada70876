"""The metadata of an index lists each session: with many thousands, it is larger than Parquet's readers take."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from dataset import build_index
from dataset.index.leaks import find_leaks
from dataset.parquet_file import read_metadata, write_table
from tests.helpers.logs import not_a_picture, write_log
from web.index.index_view import session_bins_sketch


@pytest.mark.long
def test_an_index_is_read_whose_metadata_is_beyond_what_readers_take(tmp_path: Path) -> None:
    steering = 0.5 * np.sin(np.arange(400) / 9)
    log = write_log(tmp_path / "a.mcap", steering.tolist(), not_a_picture, cameras=["center"])
    indexed = build_index([log], tmp_path / "index")
    samples, sketch = indexed.samples, session_bins_sketch(indexed.path, "a")
    file = indexed.path / "samples.parquet"
    metadata = read_metadata(file)
    assert metadata is not None
    write_table(file, samples, metadata | {"more": "x" * (101 << 20)})
    with pytest.raises(OSError, match="size limit"):
        pq.read_table(file)
    assert replace(indexed).samples.equals(samples)
    assert find_leaks(indexed.path) == []
    assert session_bins_sketch(indexed.path, "a") == sketch
