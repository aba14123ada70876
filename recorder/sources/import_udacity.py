"""Imports a recording of the Udacity simulator into a log."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from common import Skipped
from common.car import Camera
from common.progress import track
from common.untrusted import read_bounded
from recorder.bc_pb2 import VehicleState
from recorder.log.session_car import UDACITY, Car
from recorder.pictures.whole_picture import is_whole_jpeg
from recorder.sources.frame_rate import describe_clock
from recorder.sources.imported_rows import (
    FROM_1970,
    Imported,
    ImportedRow,
    SkippedEvents,
    recording_metadata,
    write_log,
)
from recorder.sources.udacity_csv import Row
from recorder.sources.udacity_recording import MAX_PICTURE_BYTES, UdacityRecording
from simulator.protocol.udacity_writer import CSV_CAMERAS

NOT_WHOLE = "pictures that are not whole JPEG files"
UNREADABLE_PICTURES = "pictures that cannot be read"


def import_udacity(
    folder: Path, log: Path, *, rate_hz: float | None = None, car: Car | None = None, overwrite: bool = False
) -> Imported:
    """Write the Udacity recording in `folder` to `log`; its pictures byte for byte, its rows in order.

    `rate_hz`: rows a second, from 1970 on, for a recording whose pictures' names hold no times. `car`: the
    recorded car, if it is not Udacity's. Raises RecordingError if nothing in it can be used, and UserError if
    `log` exists and `overwrite` is off.
    """
    events = SkippedEvents()
    recording = UdacityRecording(folder, events.skipped, rate_hz)

    def jpegs(paths: Sequence[str | None]) -> Iterator[tuple[Camera, bytes]]:
        for camera, path in zip(CSV_CAMERAS, paths, strict=True):
            if path is not None and (jpeg := _jpeg(path, events.skipped)) is not None:
                yield camera, jpeg

    rows = (ImportedRow(row.time_ns, state_of(row, car), jpegs(paths)) for row, paths in recording.rows())
    tracked = track(rows, f"importing {folder.name}", recording.line_count())
    return write_log(log, udacity_metadata(folder, rate_hz, car), tracked, events, overwrite=overwrite)


def udacity_metadata(folder: Path, rate_hz: float | None, car: Car | None) -> dict[str, str]:
    metadata = recording_metadata("udacity", folder, car)
    return metadata if rate_hz is None else metadata | {"clock": describe_clock(rate_hz), **FROM_1970}


def _jpeg(path: str, skipped: Skipped) -> bytes | None:
    name = os.path.basename(path)  # noqa: PTH119  (a Path of each would take longer)
    try:
        jpeg = read_bounded(path, MAX_PICTURE_BYTES)
    except OSError:
        skipped.add(UNREADABLE_PICTURES, name)
        return None
    if not is_whole_jpeg(jpeg):
        skipped.add(NOT_WHOLE, name)
        return None
    return jpeg


def state_of(row: Row, car: Car | None) -> VehicleState:
    speed_mph = row.speed_mph * (car or UDACITY).mph
    return VehicleState(steering=row.steering, throttle=row.throttle, brake=row.brake, speed_mph=speed_mph)
