"""Importing a recorded drive into a log."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from common import Skipped
from common.progress import track
from recorder.bc_pb2 import VehicleState
from recorder.jpeg import is_whole_jpeg
from recorder.topics import CAMERAS
from recorder.udacity import Recording, Row, read_recording
from recorder.writer import LogWriter

NOT_WHOLE = "pictures that are not whole JPEG files"
UNREADABLE = "pictures that cannot be read"


@dataclass(frozen=True)
class Imported:
    """What went into a log."""

    path: Path
    rows: int
    pictures: int
    skipped: Skipped


def import_udacity(folder: Path, log: Path, *, overwrite: bool = False) -> Imported:
    """Write the Udacity recording in `folder` to `log`; its pictures byte for byte, its rows in their order.

    Raises RecordingError if nothing in it can be used, and UserError if `log` exists and `overwrite` is off.
    """
    recording = read_recording(folder)
    metadata = {"source": "udacity", "recording": Path(os.path.realpath(recording.folder)).name}
    with LogWriter(log, metadata, overwrite=overwrite) as writer:
        rows = track(recording.rows, f"importing {recording.folder.name}", len(recording.rows))
        pictures = _write_rows(writer, rows, recording)
        for reason, name in recording.skipped:
            writer.event(recording.rows[0].time_ns, f"skipped {reason}: {name}", "WARNING", "recorder")
    return Imported(log, len(recording.rows), pictures, recording.skipped)


def _write_rows(writer: LogWriter, rows: Iterable[Row], recording: Recording) -> int:
    pictures = 0
    for sequence, row in enumerate(rows):
        for camera, name in zip(CAMERAS, row.names, strict=True):
            path = recording.pictures.get(name)
            if path is None:
                continue
            try:
                with open(path, "rb", buffering=0) as file:  # noqa: PTH123  (a Path of each would take longer)
                    jpeg = file.read()
            except OSError:
                recording.skipped.add(UNREADABLE, name)
                continue
            if not is_whole_jpeg(jpeg):
                recording.skipped.add(NOT_WHOLE, name)
                continue
            writer.picture(camera, row.time_ns, sequence, jpeg)
            pictures += 1
        writer.vehicle(row.time_ns, sequence, vehicle_state(row))
    return pictures


def vehicle_state(row: Row) -> VehicleState:
    return VehicleState(steering=row.steering, throttle=row.throttle, brake=row.brake, speed_mph=row.speed_mph)
