"""Small logs, and their messages as mcap's own reader sees them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.records import Message
from mcap_protobuf.decoder import DecoderFactory

from common.car import CAMERAS, Camera
from recorder import Log, LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log.session_car import Car, metadata_of
from recorder.log.tags import read_tags

START_NS = 1_720_880_000_000_000_000
STEP_NS = 100_000_000


def not_a_picture(camera: Camera, row: int) -> bytes:
    """Bytes of their own for every frame: whoever does not look at pictures does not mind."""
    return f"{camera} {row}".encode()


def write_log(
    path: Path,
    steering: Sequence[float],
    picture: Callable[[Camera, int], bytes] = not_a_picture,
    *,
    cameras: Sequence[Camera] = CAMERAS,
    start_ns: int = START_NS,
    step_ns: int = STEP_NS,
    source: str = "test",
    overwrite: bool = False,
    car: Car | None = None,
) -> Path:
    """A log of one frame for each steering, a tenth of a second apart."""
    with LogWriter(path, {"source": source} | metadata_of(car), overwrite=overwrite) as writer:
        for row, value in enumerate(steering):
            time_ns = start_ns + row * step_ns
            for camera in cameras:
                writer.picture(camera, time_ns, row, picture(camera, row))
            writer.vehicle(time_ns, row, VehicleState(steering=value, throttle=0.5, brake=0.0, speed_mph=9.0))
    return path


def write_session(path: Path, steering: Sequence[float], content: str = "") -> Path:
    """The same with pictures that are no other session's; another `content` gives others."""
    name = f"{path.stem}{content}"
    return write_log(path, steering, lambda camera, row: f"{name} {camera} {row}".encode(), overwrite=True)


def read_messages(path: Path) -> dict[str, list[tuple[Message, Any]]]:
    """Messages and their decoded contents by topic, in the order of the file, every CRC checked."""
    found: dict[str, list[tuple[Message, Any]]] = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            found[channel.topic].append((message, decoded))
    return dict(found)


def tags_of(path: Path) -> list[tuple[int, int, str]]:
    with Log(path) as log:
        return [(tag.first_row, tag.last_row, tag.name) for tag in read_tags(path, log.fingerprint)]


def flip_bit(path: Path, *positions: int) -> None:
    """Damage these bytes of a file; below 0, they count from its end."""
    data = bytearray(path.read_bytes())
    for position in positions:
        data[position] ^= 1
    path.write_bytes(data)


def plain_read(path: Path, offset: int, length: int) -> bytes:
    """Bytes of a file, without any of the toolkit's code."""
    with path.open("rb") as stream:
        stream.seek(offset)
        return stream.read(length)
