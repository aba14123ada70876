"""The device that a person steered with in each row of a log."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recorder.log.reader import Log
from recorder.rows.devices import DEVICES
from recorder.topics import VEHICLE


def device_numbers(log: Log) -> NDArray[np.int8]:
    """The position in `DEVICES` of each vehicle state of a log (N,). Raises LogError for a damaged log."""
    numbers = log.numbers(VEHICLE, ["device"])["device"].to_numpy()
    is_known = (numbers >= 0) & (numbers < len(DEVICES))  # a later version may know more
    return np.where(is_known, numbers, 0).astype(np.int8)
