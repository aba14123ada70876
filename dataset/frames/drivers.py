"""The driver at each frame of a drive: the network (the pilot), an expert or a human."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dataset.config import Drives
from recorder import Log

Driver = Literal["", "pilot", "human", "expert"]
DRIVERS: Final[tuple[Driver, ...]] = get_args(Driver)
"""In the order of PilotCommand.Driver; "" if unknown, as in a session that is not a drive."""

TAKEOVERS: Final = (DRIVERS.index("expert"), DRIVERS.index("human"))


@dataclass(frozen=True)
class Commands:
    """The commands of a drive; arrays of the same length, in the order of writing, empty for other sessions."""

    sequence: NDArray[np.int64]
    log_time_ns: NDArray[np.int64]
    driver: NDArray[np.int8]  # position in DRIVERS
    steering: NDArray[np.float64]  # as sent


def read_commands(log: Log) -> Commands:
    """The commands in a log. Raises LogError if the log is damaged."""
    numbers, steering = array("q"), array("d")
    for message, command in log.commands():
        # a driver of a later version is unknown
        driver = command.driver if 0 <= command.driver < len(DRIVERS) else 0
        numbers.extend((message.sequence, message.log_time_ns, driver))
        steering.append(command.steering)
    sequence, log_time_ns, drove = np.array(numbers, np.int64).reshape(-1, 3).T
    return Commands(sequence, log_time_ns, drove.astype(np.int8), np.array(steering, np.float64))


def is_taken(driver: NDArray[np.int8], drives: Drives) -> NDArray[np.bool_]:
    """A mask (N,) of the rows to use, from their drivers (positions in `DRIVERS`). If no driver is known: all."""
    if drives == "all" or not driver.any():
        return np.ones(len(driver), np.bool_)
    return np.isin(driver, TAKEOVERS)
