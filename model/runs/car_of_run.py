"""The car for which a run answers: the car of its sessions, from its config.json."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from common.car import MAX_STEERING_DEG
from common.steering_unit import assumed_deg
from model.errors import RunError
from model.runs.run_folder import load_config


def max_steering_deg_of_run(run: Path) -> float:
    """The angle of the front wheels, in degrees, when the run answers 1; 25 if unknown. Raises RunError as
    `load_config` does."""
    degrees = {_number(log.get("max_steering_deg", MAX_STEERING_DEG)) for log in _logs(run).values()}
    angle_deg = degrees.pop() if len(degrees) == 1 else MAX_STEERING_DEG
    return angle_deg if 0 < angle_deg < 90 else MAX_STEERING_DEG


def known_max_steering_deg_of_run(run: Path) -> float | None:
    """`max_steering_deg_of_run`; None if a session of the run does not record the angle."""
    is_unknown = any(log.get("max_steering_deg", MAX_STEERING_DEG) is None for log in _logs(run).values())
    return None if is_unknown else max_steering_deg_of_run(run)


def cars_of_run(run: Path) -> list[Any]:
    """The car settings of each session of the run, as unchecked JSON; None for a session without. Raises RunError
    as `load_config` does."""
    return [log.get("car") for log in _logs(run).values()]


def refuse_other_steering(run: Path, max_steering_deg: float | None, source: str) -> None:
    """Raise RunError if steering 1 is a different angle in the run and in `source`, a log or an index."""
    own, other = max_steering_deg_of_run(run), assumed_deg(max_steering_deg)
    if own != other:
        raise RunError(
            f"{run}: steering 1 turns the wheels by {own:g} degrees, in {source} by {other:g} degrees: they cannot"
            " be used together"
        )


def _logs(run: Path) -> dict[str, dict[str, Any]]:
    data = load_config(run).get("data")
    logs = data.get("logs") if isinstance(data, dict) else None
    return {name: log for name, log in logs.items() if isinstance(log, dict)} if isinstance(logs, dict) else {}


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
