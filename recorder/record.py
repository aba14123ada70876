"""Importing a recorded drive into a log."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from common import Skipped
from common.progress import track
from recorder.bc_pb2 import VehicleState
from recorder.topics import CAMERAS
from recorder.udacity import Recording, Row, read_recording
from recorder.writer import LogWriter

JPEG_START, JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"


def _is_whole_jpeg(data: bytes) -> bool:
    if not data.startswith(JPEG_START) or JPEG_END not in data[-64:]:  # some cameras pad the end
        return False
    try:  # an eighth of the size: a fraction of the time, and the whole file is still read through
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_REDUCED_GRAYSCALE_8) is not None
    except cv2.error:
        return False


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
    metadata = {"source": "udacity", "recording": recording.folder.resolve().name}
    with LogWriter(log, metadata, overwrite=overwrite) as writer:
        rows = track(recording.rows, f"importing {recording.folder.name}", len(recording.rows))
        pictures = _write_rows(writer, rows, recording)
        for reason, name in recording.skipped:
            writer.event(recording.rows[0].time_ns, f"skipped {reason}: {name}", "WARNING", "recorder")
    return Imported(log, len(recording.rows), pictures, recording.skipped)


def _write_rows(writer: LogWriter, rows: Iterable[Row], recording: Recording) -> int:
    pictures = 0
    for sequence, row in enumerate(rows):
        for camera in CAMERAS:
            path = row.pictures.get(camera)
            if path is None:
                continue
            jpeg = path.read_bytes()
            if not _is_whole_jpeg(jpeg):
                recording.skipped.add("pictures that are not whole JPEG files", path.name)
                continue
            writer.picture(camera, row.time_ns, sequence, jpeg)
            pictures += 1
        state = VehicleState(
            steering=row.steering, throttle=row.throttle, brake=row.brake, speed_mph=row.speed_mph
        )
        writer.vehicle(row.time_ns, sequence, state)
    return pictures
