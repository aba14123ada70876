"""The readings of a video's instruments at each moment of a log."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from recorder import Log
from recorder.bc_pb2 import PilotCommand
from recorder.log.session_car import known_max_steering_deg
from recorder.rows.row_quality import GAP_S
from recorder.topics import DRIVE_METADATA, PILOT_COMMAND, VEHICLE
from viz.video_overlay import Driver, Reading

_DRIVERS: Final[dict[float, Driver]] = {
    PilotCommand.PILOT: "network",
    PilotCommand.HUMAN: "human",
    PilotCommand.EXPERT: "expert",
}
_MIN_TOP_MPH, _MAX_TOP_MPH = 30.0, 300.0  # the simulator's car reaches 30


class Readings:
    """The vehicle states and commands of a log by time."""

    def __init__(self, log: Log) -> None:
        """Raises LogError if the log is damaged."""
        self._begin_ns = log.time_range_ns[0]
        self._states = _Rows(log, VEHICLE, "steering", "throttle", "brake", "speed_mph")
        self._commands = _Rows(log, PILOT_COMMAND, "predicted_steering", "set_speed_mph", "driver")
        self.max_steering_deg = known_max_steering_deg(log)
        """The wheels' angle at steering 1; None: unknown."""
        # the driver of a session of the built-in simulator; in a drive, each command names the driver
        self._driver: Driver | None = "expert" if log.metadata.get("driver") == "expert" else None
        self._autonomy_percent = _percent(log.read_metadata(DRIVE_METADATA).get("autonomy_percent", ""))

    @property
    def top_mph(self) -> float:
        """The end of the speed bar."""
        top = max(_MIN_TOP_MPH, min(self._states.largest(3), _MAX_TOP_MPH))
        return 10.0 * math.ceil(top / 10)

    def at(self, time_ns: int) -> Reading:
        """The readings at a log time: the last values until then, at most a second old."""
        steering, throttle, brake, speed_mph = self._states.at(time_ns)
        predicted, set_speed_mph, driver = self._commands.at(time_ns)
        return Reading(
            time_s=max(0, time_ns - self._begin_ns) / 1e9,
            steering=steering,
            predicted_steering=predicted,
            throttle=throttle,
            brake=brake,
            speed_mph=speed_mph,
            set_speed_mph=set_speed_mph,
            driver=self._driver if math.isnan(driver) else _DRIVERS.get(driver),
            autonomy_percent=self._autonomy_percent,
        )


class _Rows:
    """Numbers of the messages on a topic, by time."""

    def __init__(self, log: Log, topic: str, *fields: str) -> None:
        table = log.numbers(topic, fields)
        times_ns = table["log_time_ns"].to_numpy()
        order = np.argsort(times_ns, kind="stable")
        self._times_ns = times_ns[order]
        self._values = np.stack([table[name].to_numpy() for name in fields], axis=1)[order]

    def at(self, time_ns: int) -> list[float]:
        """The last values at `time_ns` or up to `GAP_S` before it; NaN without them."""
        place = int(np.searchsorted(self._times_ns, time_ns, "right")) - 1
        if place < 0 or time_ns - int(self._times_ns[place]) > GAP_S * 1e9:
            return [math.nan] * self._values.shape[1]
        row: list[float] = self._values[place].tolist()
        return row

    def largest(self, column: int) -> float:
        """The largest finite number of a column, but at least 0."""
        numbers = self._values[:, column]
        return float(np.max(numbers[np.isfinite(numbers)], initial=0.0))


def _percent(text: str) -> float:
    """A percentage in a log's metadata; NaN if the text is not a percentage."""
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if 0 <= value <= 100 else math.nan
