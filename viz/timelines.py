"""The time lines on which logs are shown: seconds since their start, and log time."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from typing import Final

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import Chunk

SINCE_START: Final = "since start"
LOG_TIME: Final = "message_log_time"  # the name in Rerun's MCAP reader

Times = NDArray[np.int64]
Clock = Callable[[Times], list[rr.TimeColumn]]  # converts log times (N,) in ns to time lines


def log_clock(start_ns: int) -> Clock:
    """A clock with seconds since the log's start and log time."""
    since_start = start_clock(start_ns)
    return lambda time_ns: [
        *since_start(time_ns),
        rr.TimeColumn(LOG_TIME, timestamp=time_ns.astype("datetime64[ns]")),
    ]


def start_clock(start_ns: int) -> Clock:
    """A clock with only seconds since the log's start, which logs of different days can share."""
    return lambda time_ns: [rr.TimeColumn(SINCE_START, duration=(time_ns - start_ns).astype("timedelta64[ns]"))]


def on_clock(chunks: Iterable[Chunk], clock: Clock, left_out: str = "") -> Generator[Chunk]:
    """Move chunks of Rerun's reader to the time lines of `clock`, without the component `left_out`. Chunks without
    a time stay unchanged."""
    for chunk in chunks:
        if LOG_TIME not in chunk.timeline_names:
            yield chunk  # data of the whole file
            continue
        batch = chunk.to_record_batch()
        data = [field for field in batch.schema if (field.metadata or {}).get(b"rerun:kind") == b"data"]
        fields = [field for field in data if field.name != left_out]
        if not fields:
            continue
        times = clock(batch.column(LOG_TIME).cast(pa.int64()).to_numpy(zero_copy_only=False))
        columns = [time.as_arrow_array() for time in times]
        names = [time.timeline_name() for time in times]
        moved = pa.RecordBatch.from_arrays(
            [*columns, *(batch.column(field.name) for field in fields)],
            schema=pa.schema(
                [*(pa.field(name, column.type) for name, column in zip(names, columns, strict=True)), *fields]
            ),
        )
        yield from Chunk.from_record_batch(moved, index=names, entity_path=chunk.entity_path)
