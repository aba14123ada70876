"""`index/samples.parquet`: its name, and the version and the columns on which its writer and its readers agree."""

from __future__ import annotations

from typing import Final

import pyarrow as pa

SAMPLES_NAME: Final = "samples.parquet"
METADATA_KEY: Final = b"bc.index"
"""Under it, each parquet file of an index says what it was made from."""

FORMAT: Final = 4

SCHEMA: Final = pa.schema(
    [
        pa.field("session", pa.string()),
        pa.field("row", pa.int64()),
        pa.field("camera", pa.string()),
        pa.field("log_time_ns", pa.int64()),
        pa.field("offset", pa.int64()),
        pa.field("length", pa.int64()),
        pa.field("chunk", pa.int64()),
        pa.field("flip", pa.bool_()),
        pa.field("alteration", pa.string()),  # "", or names joined by "+"
        pa.field("seed", pa.int64()),  # of the alteration
        pa.field("label", pa.float64()),  # steering to be learnt, of this camera and this side: -1..1
        pa.field("recorded", pa.float64()),  # the same as it was driven
        pa.field("bin", pa.int64()),
        pa.field("split", pa.string()),
        pa.field("copy", pa.bool_()),  # added to fill up its bin
    ]
)
