"""Importing a recording of the Udacity simulator into a log."""

from __future__ import annotations

import itertools
import os
from pathlib import Path

from common import Skipped
from common.progress import track
from common.untrusted import read_bounded
from recorder.bc_pb2 import VehicleState
from recorder.log.session_car import UDACITY, Car, metadata_of
from recorder.log.writer import LogWriter
from recorder.pictures.whole_picture import is_whole_jpeg
from recorder.sources.frame_rate import describe_clock
from recorder.sources.imported_rows import Imported, SkippedEvents
from recorder.sources.udacity_csv import Row
from recorder.sources.udacity_recording import MAX_PICTURE_BYTES, UdacityRecording
from simulator.protocol.udacity_writer import CSV_CAMERAS

NOT_WHOLE = "pictures that are not whole JPEG files"
UNREADABLE_PICTURES = "pictures that cannot be read"


def import_udacity(
    folder: Path, log: Path, *, rate_hz: float | None = None, car: Car | None = None, overwrite: bool = False
) -> Imported:
    """Write the Udacity recording in `folder` to `log`; its pictures byte for byte, its rows in their order.

    `rate_hz` is for a recording whose pictures' names hold no times: its rows are so many a second, from 1970 on.
    `car` is the one that was recorded, if that is not Udacity's.
    Raises RecordingError if nothing in it can be used, and UserError if `log` exists and `overwrite` is off.
    """
    events = SkippedEvents()
    recording = UdacityRecording(folder, events.skipped, rate_hz)
    metadata = udacity_metadata(folder, rate_hz, car)
    row_count = pictures = 0
    rows = recording.rows()
    first = next(rows)  # without any, nothing is begun
    with LogWriter(log, metadata, overwrite=overwrite) as writer:
        all_rows = itertools.chain([first], rows)
        for row, paths in track(all_rows, f"importing {folder.name}", recording.line_count()):
            events.at(writer, row.time_ns)
            for camera, path in zip(CSV_CAMERAS, paths, strict=True):
                jpeg = _jpeg(path, events.skipped) if path is not None else None
                if jpeg is not None:
                    writer.picture(camera, row.time_ns, row_count, jpeg)
                    pictures += 1
            writer.vehicle(row.time_ns, row_count, vehicle_state(row, car))
            row_count += 1
    return Imported(log, row_count, pictures, events.skipped, writer.notices)


def udacity_metadata(folder: Path, rate_hz: float | None, car: Car | None) -> dict[str, str]:
    """The metadata of a Udacity recording's log."""
    metadata = {"source": "udacity", "recording": Path(os.path.realpath(folder)).name} | metadata_of(car)
    if rate_hz is not None:
        metadata["clock"] = describe_clock(rate_hz)
        metadata["start"] = "1970, because the recording does not have it"
    return metadata


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


def vehicle_state(row: Row, car: Car | None) -> VehicleState:
    speed_mph = row.speed_mph * (car or UDACITY).mph
    return VehicleState(steering=row.steering, throttle=row.throttle, brake=row.brake, speed_mph=speed_mph)
