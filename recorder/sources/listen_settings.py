"""The settings of a recording of telemetry."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from recorder.log.session_car import Car


class ListenSettings(NamedTuple):
    """Where a simulator connects, and what is known of it."""

    host: str = "127.0.0.1"
    port: int = 4567
    idle_s: float | None = None
    car: Car | None = None
    on_started: Callable[[Path], None] | None = None
