"""Parses, checks and logs telemetry, and formats commands.

Parsing accepts any object. It raises only TelemetryError if it is not a telemetry message.
"""

from __future__ import annotations

import base64
import binascii
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from common.car import CAMERAS, Camera
from common.errors import brief, counted
from recorder.bc_pb2 import VehicleState
from recorder.log.session_car import UDACITY, Car
from recorder.log.writer import LogWriter, pose_message
from recorder.pictures.picture_size import PNG_START, whole_jpeg_size, whole_png_size
from recorder.server.locale_numbers import POINT, decimal_separator, format_number, parse_number
from recorder.server.world import World, json_kind, parse_world
from recorder.topics import Device, device_value

MAX_IMAGE_BYTES: Final = 1 << 20  # base64; the simulator's pictures have about 20 KB

NOT_JSON: Final = object()  # the data of a telemetry that is not JSON, or too deep; it is answered, too

MAX_SPEED_MPH: Final = 1e7  # higher speeds make unreadable distances

_NUMBERS: Final = ("steering_angle", "throttle", "speed")
_FIELDS: Final = (*_NUMBERS, "image")
SIDE_IMAGES: Final[Mapping[Camera, str]] = {name: f"image_{name}" for name in CAMERAS if name != "center"}
"""The fields of the other cameras' pictures, which a simulator may leave out."""
_MAX_FIELDS_SHOWN: Final = 6
_MAX_CHARACTERS_SHOWN: Final = 30  # of a client's text, in a reason


class TelemetryError(ValueError):
    """An unusable telemetry, which is answered nevertheless.

    Its text is the reason with the client's values; `kind` is the reason without values, for counting.
    """

    def __init__(self, kind: str, detail: str = "") -> None:
        super().__init__(kind + detail)
        self.kind = kind
        self.speed_mph: float | None = None  # this and the attributes below are the readable parts
        self.decimal_separator: str | None = None
        self.world: World | None = None
        self.world_problems: tuple[str, ...] = ()


@dataclass(frozen=True)
class Telemetry:
    steering: float  # -1 (left) .. 1 (right), of the wheels now; not clamped
    throttle: float  # 0..1; not clamped
    speed_mph: float  # NaN for a car without a speed (Gymnasium); messages must have one
    picture: bytes  # of the centre camera
    decimal_separator: str = POINT  # of the simulator's machine
    observed_separator: str | None = None  # the same, if this telemetry proves it
    world: World | None = None  # None if the simulator sends only the real one's fields
    world_problems: tuple[str, ...] = ()  # its unusable members, with reasons
    side_pictures: Mapping[Camera, bytes] = field(default_factory=dict)  # whole ones
    side_problems: tuple[str, ...] = ()  # reasons why others are unusable, without values


def parse_telemetry(data: object, known_separator: str | None = None, car: Car = UDACITY) -> Telemetry:
    """Parse a message's data. Raises TelemetryError with the reason and the readable parts.

    `known_separator`: the decimal separator of the connection's earlier telemetry; whole numbers and 1,234 do not
    show it. `car`: for the wheels' angle at steering 1, and the unit of the speed.
    """
    if data is NOT_JSON:
        raise TelemetryError("telemetry is not JSON")
    if not isinstance(data, dict):
        is_encoded = isinstance(data, str) and data.lstrip().startswith("{")
        hint = " (send the object, not a string of JSON)" if is_encoded else ""
        raise TelemetryError(f"not an object but {json_kind(data)}", hint)
    observed = _decimal_separator(data)
    decimal = observed or known_separator or POINT  # "N4", the default, never writes three decimals
    numbers: dict[str, float] = {}
    problems: list[TelemetryError] = []
    if missing := [name for name in _FIELDS if name not in data]:
        problems.append(_missing(missing, data))
    for name in _NUMBERS:
        if name not in missing:
            try:
                numbers[name] = _number(data[name], name, decimal, car.mph if name == "speed" else 1.0)
            except TelemetryError as error:
                problems.append(error)
    try:
        picture = _image(data["image"], "image") if "image" not in missing else b""
    except TelemetryError as error:
        problems.append(error)
    world, world_problems = parse_world(data.get("world"), decimal)
    if problems:
        problem = problems[0]
        problem.speed_mph, problem.decimal_separator = numbers.get("speed"), observed
        problem.world, problem.world_problems = world, world_problems
        raise problem
    side_pictures, side_problems = _side_pictures(data)
    return Telemetry(
        steering=numbers["steering_angle"] / car.max_steering_deg,
        throttle=numbers["throttle"],
        speed_mph=numbers["speed"],
        picture=picture,
        decimal_separator=decimal,
        observed_separator=observed,
        world=world,
        world_problems=world_problems,
        side_pictures=side_pictures,
        side_problems=side_problems,
    )


def check_whole_picture(picture: bytes, name: str = "image") -> tuple[int, int]:
    """The width and height of a JPEG or PNG from the field `name`.

    Raises TelemetryError if it is not complete: the rest of a picture that is cut off would be grey.
    """
    is_png = picture.startswith(PNG_START[:4])
    if (size := whole_png_size(picture) if is_png else whole_jpeg_size(picture)) is not None:
        return size
    size_text = f" ({counted(len(picture), 'byte')})"
    if is_png or picture.startswith(b"\xff\xd8"):
        raise TelemetryError(f"{name} is a {'PNG' if is_png else 'JPEG'} that is cut off or damaged", size_text)
    raise TelemetryError(f"{name} is not a JPEG or PNG", size_text)


def format_command(steering: float, throttle: float, decimal_separator: str = POINT) -> dict[str, str]:
    """A `steer` command, with strings: the simulator drops an answer with JSON numbers."""
    return {
        "steering_angle": format_number(steering, decimal_separator),
        "throttle": format_number(throttle, decimal_separator),
    }


def _decimal_separator(data: dict[object, object]) -> str | None:
    """The decimal separator that one of the numbers proves; None if none does."""
    for name in ("throttle", "steering_angle", "speed"):
        value = data.get(name)
        if isinstance(value, str) and parse_number(value) is not None and (observed := decimal_separator(value)):
            return observed
    return None


def _missing(names: list[str], data: dict[object, object]) -> TelemetryError:
    present = ", ".join(brief(str(name), _MAX_CHARACTERS_SHOWN) for name in list(data)[:_MAX_FIELDS_SHOWN]) + (
        ", ..." if len(data) > _MAX_FIELDS_SHOWN else ""
    )
    which = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
    return TelemetryError(
        f"{which} {'is' if len(names) == 1 else 'are'} missing", f" (received: {present or 'nothing'})"
    )


def _number(value: object, field: str, decimal: str, unit: float) -> float:
    """The number in a present field, times `unit`. Raises TelemetryError for anything else."""
    if value is None:
        raise TelemetryError(f"{field} is null")
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise TelemetryError(f"{field} is not a number but {json_kind(value)}")
    try:
        number = parse_number(value, decimal) if isinstance(value, str) else float(value)
    except OverflowError:
        number = math.inf
    if number is None:
        raise TelemetryError(f"{field} is not a number", f" ({brief(str(value), _MAX_CHARACTERS_SHOWN)})")
    if not math.isfinite(number):
        raise TelemetryError(f"{field} is not finite")
    number *= unit
    if field == "speed" and abs(number) > MAX_SPEED_MPH:
        raise TelemetryError(f"speed is beyond {MAX_SPEED_MPH:,.0f} mph")
    return number


def _side_pictures(data: dict[object, object]) -> tuple[dict[Camera, bytes], tuple[str, ...]]:
    """The whole pictures of the side cameras, and the kinds of problems with the others."""
    pictures: dict[Camera, bytes] = {}
    problems = []
    for camera, name in SIDE_IMAGES.items():
        if data.get(name) is not None:
            try:
                picture = _image(data[name], name)
                check_whole_picture(picture, name)
                pictures[camera] = picture
            except TelemetryError as error:
                problems.append(error.kind)
    return pictures, tuple(problems)


def _image(value: object, name: str) -> bytes:
    """The picture in a present field. Raises TelemetryError for anything else."""
    if value is None:
        raise TelemetryError(f"{name} is null")
    if not isinstance(value, str):
        raise TelemetryError(f"{name} is not a string but {json_kind(value)}")
    if not value:
        raise TelemetryError(f"{name} is empty")
    if len(value) > MAX_IMAGE_BYTES:
        raise TelemetryError(f"{name} is larger than {MAX_IMAGE_BYTES:,} bytes")
    if value.startswith("data:"):
        raise TelemetryError(f"{name} begins with data:", " (send only what comes after base64,)")
    try:
        return base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError):
        raise TelemetryError(f"{name} is not base64") from None


def write_telemetry(
    writer: LogWriter,
    time_ns: int,
    row: int,
    telemetry: Telemetry,
    device: Device | None,
    *,
    brake: float = 0.0,
    not_recorded_s: float = 0.0,
    picture_size: tuple[int, int] | None = None,
    crop: bytes | None = None,
) -> None:
    """Write pictures, vehicle state and pose. `crop`: a PNG of the network's input."""
    if telemetry.picture:
        writer.picture("center", time_ns, row, telemetry.picture, picture_size)
    for camera, picture in telemetry.side_pictures.items():
        writer.picture(camera, time_ns, row, picture)
    if crop is not None:
        writer.crop(time_ns, row, crop)
    state = VehicleState(
        steering=telemetry.steering,
        throttle=telemetry.throttle,
        brake=brake,
        speed_mph=telemetry.speed_mph,
        device=device_value(device),
        not_recorded_s=not_recorded_s or None,
    )
    writer.vehicle(time_ns, row, state)
    pose = None if telemetry.world is None else telemetry.world.pose
    if pose is not None:
        writer.pose(time_ns, row, pose_message(pose, time_ns))
