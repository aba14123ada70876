"""The driver at each frame of a drive: the network (the pilot), an expert or a human."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dataset.config import Drives
from recorder import Log
from recorder.mcap.message_index import known_values
from recorder.topics import PILOT_COMMAND

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
    table = log.numbers(PILOT_COMMAND, ["driver", "steering"])
    sequence, log_time_ns, driver, steering = (column.to_numpy() for column in table.columns)
    return Commands(sequence, log_time_ns, known_values(driver, len(DRIVERS)), steering)


def is_taken(driver: NDArray[np.int8], drives: Drives) -> NDArray[np.bool_]:
    """A mask (N,) of the rows to use, from their drivers (positions in `DRIVERS`). If no driver is known: all."""
    if drives == "all" or not driver.any():
        return np.ones(len(driver), np.bool_)
    return np.isin(driver, TAKEOVERS)
