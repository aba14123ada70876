"""The devices that a person steers with. Rows of a log hold their numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

Device = Literal["keyboard", "mouse", "gamepad", "touch"]
RowDevice = Device | Literal[""]
DEVICES: Final[tuple[RowDevice, ...]] = ("", *get_args(Device))
"""In the order of VehicleState.Device; empty if nobody steered by hand, or the device is unknown."""


def device_value(device: Device | None) -> str | None:
    """The device as the value of `VehicleState.device`."""
    return device.upper() if device else None


def most_used(rows: Mapping[int, int]) -> RowDevice:
    """The device of most rows, from the number of rows by device number; empty if no device is known."""
    by_hand = {number: count for number, count in rows.items() if 0 < number < len(DEVICES) and count}
    return DEVICES[max(by_hand, key=lambda number: by_hand[number])] if by_hand else ""


def most_used_of(numbers: NDArray[np.int8]) -> RowDevice:
    """The device of most rows, from the device number of each row (N,); empty if no device is known."""
    return most_used(dict(enumerate(np.bincount(numbers, minlength=len(DEVICES)).tolist())))
