"""The frames of a log in which nobody drives, as of crashes: their steering has nothing to do with the road."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from dataset.frames.pairing import moments
from recorder import Log
from recorder.rows.row_quality import NOT_LEARNT, States, row_flags


def in_crashes(frames: pa.Table, log: Log) -> NDArray[np.bool_]:
    """A mask of the `frames` of a log (N,), by those flags of its rows that are `NOT_LEARNT`, which an index of an
    earlier version does not have. `frames` needs the columns row and log_time_ns. Raises LogError for a damaged
    log."""
    vehicle = log.vehicle()
    flags = row_flags(States.of(vehicle))
    crashed = vehicle.filter(pa.array(np.logical_or.reduce([flags[flag] for flag in NOT_LEARNT])))
    return np.isin(moments(frames), moments(crashed))
