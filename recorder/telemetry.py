"""The simulator's messages: telemetry as it is told, and commands as it understands them.

Telemetry comes from outside and may be anything; what is not a telemetry raises TelemetryError, never more.
"""

from __future__ import annotations

import base64
import binascii
import math
import re
from dataclasses import dataclass
from typing import Final

from recorder.topics import MAX_STEERING_DEG
from recorder.world import World, parse_world

MAX_IMAGE_BYTES: Final = 1 << 20  # base64; the simulator's own are about 20 KB

MAX_SPEED_MPH: Final = 1e7  # what is beyond makes distances that nobody can read

_NUMBER = re.compile(r"[+-]?\d[\d.,\u00a0\u202f' ]*([eE][+-]?\d+)?")


class TelemetryError(ValueError):
    """A telemetry that cannot be used; it is answered all the same."""


@dataclass(frozen=True)
class Telemetry:
    """One moment as the simulator tells it."""

    steering: float  # -1 (left) .. 1 (right), the wheels as they are
    throttle: float  # 0..1
    speed_mph: float
    jpeg: bytes
    decimal_comma: bool  # the simulator's machine writes 0,5 for a half, and wants to read it
    world: World | None = None  # None unless the simulator tells more than the real one does
    world_problems: tuple[str, ...] = ()  # what of it could not be used, and why


def parse_telemetry(data: object) -> Telemetry:
    """Raises TelemetryError with the reason."""
    if not isinstance(data, dict):
        raise TelemetryError(f"not an object but a {type(data).__name__}")
    throttle = data.get("throttle")
    # At most 1, so it never has a thousands separator: the separator it has tells the machine's culture.
    decimal_comma = isinstance(throttle, str) and "," in throttle
    degrees = _number(data, "steering_angle", decimal_comma)
    speed_mph = _number(data, "speed", decimal_comma)
    if abs(speed_mph) > MAX_SPEED_MPH:
        raise TelemetryError(f"speed is beyond {MAX_SPEED_MPH:,.0f} mph")
    world, world_problems = parse_world(data.get("world"), decimal_comma)
    return Telemetry(
        steering=min(max(degrees / MAX_STEERING_DEG, -1.0), 1.0),
        throttle=min(max(_number(data, "throttle", decimal_comma), 0.0), 1.0),
        speed_mph=speed_mph,
        jpeg=_image(data.get("image")),
        decimal_comma=decimal_comma,
        world=world,
        world_problems=world_problems,
    )


def format_command(steering: float, throttle: float, decimal_comma: bool) -> dict[str, str]:
    """A `steer` command: strings, because the simulator drops a telemetry whose answer holds JSON numbers."""
    values = {"steering_angle": f"{steering:.6f}", "throttle": f"{throttle:.6f}"}
    if decimal_comma:
        values = {name: text.replace(".", ",") for name, text in values.items()}
    return values


def _number(data: dict[object, object], field: str, decimal_comma: bool) -> float:
    value = data.get(field)
    if isinstance(value, str) and len(value) < 64 and _NUMBER.fullmatch(value.strip()):
        decimal, thousands = (",", ".") if decimal_comma else (".", ",")
        # other cultures group thousands by spaces or apostrophes
        plain = re.sub(r"[\u00a0\u202f' ]", "", value.strip().replace(thousands, "")).replace(decimal, ".")
        try:
            number = float(plain)
        except ValueError:
            raise TelemetryError(f"{field} is not a number") from None
    elif isinstance(value, int | float) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            raise TelemetryError(f"{field} is not finite") from None
    else:
        raise TelemetryError(f"{field} is missing or not a number")
    if not math.isfinite(number):
        raise TelemetryError(f"{field} is not finite")
    return number


def _image(value: object) -> bytes:
    if not isinstance(value, str) or not value:
        raise TelemetryError("image is missing or not a string")
    if len(value) > MAX_IMAGE_BYTES:
        raise TelemetryError(f"image is larger than {MAX_IMAGE_BYTES} bytes")
    try:
        return base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError):
        raise TelemetryError("image is not base64") from None
