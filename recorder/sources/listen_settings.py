"""The settings of a recording of telemetry."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from recorder.log.session_car import Car


class ListenSettings(NamedTuple):
    """Where a simulator connects, and what is known of it."""

    host: str = "127.0.0.1"
    port: int = 4567  # 0: a free one
    idle_s: float | None = None  # the recording ends so long after the last telemetry
    car: Car | None = None  # that is recorded, if it is not Udacity's or the built-in one's
    on_started: Callable[[Path], None] | None = None  # gets the path of the growing file, once the server listens
