"""The frames of a log that are from crashes: their steering has nothing to do with the road."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from dataset.frames.pairing import moments
from recorder import Log
from recorder.log.row_quality import States, row_flags


def in_crashes(frames: pa.Table, log: Log) -> NDArray[np.bool_]:
    """A mask of the `frames` of a log (N,), by the flag `crash` of its rows, which an index of an earlier version
    does not have. `frames` needs the columns row and log_time_ns. Raises LogError for a damaged log."""
    vehicle = log.vehicle()
    crashed = vehicle.filter(pa.array(row_flags(States.of(vehicle))["crash"]))
    return np.isin(moments(frames), moments(crashed))
