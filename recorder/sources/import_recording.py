"""Importing a recorded drive into a log."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from common import Skipped
from common.errors import KEPT_NAMES
from common.progress import track
from common.untrusted import read_bounded
from recorder.bc_pb2 import VehicleState
from recorder.log.writer import LogWriter
from recorder.pictures.jpeg import is_whole_jpeg
from recorder.sources.frame_rate import clock
from recorder.sources.udacity_csv import COLUMNS, Row
from recorder.sources.udacity_recording import MOST_PICTURE_BYTES, UdacityFolder

NOT_WHOLE = "pictures that are not whole JPEG files"
UNREADABLE = "pictures that cannot be read"


@dataclass(frozen=True)
class Imported:
    """What went into a log."""

    path: Path
    rows: int
    pictures: int
    skipped: Skipped
    notices: Sequence[str] = ()  # what a person should know of what is in it


class SkippedEvents:
    """What an import leaves out, each one also an event in its log as it comes.

    What is left out before the first row waits for it, and is only counted where a thousand of its kind wait.
    """

    def __init__(self) -> None:
        self.skipped = Skipped(self._added)
        self._writer: LogWriter | None = None
        self._time_ns = 0

    def at(self, writer: LogWriter, time_ns: int) -> None:
        """What follows belongs to, or comes after, the row of this time."""
        is_first = self._writer is None
        self._writer, self._time_ns = writer, time_ns
        if is_first:
            for reason, name in self.skipped:
                self._added(reason, name)
            for reason, count in self.skipped.counts.items():
                if count > KEPT_NAMES:
                    self._added(reason, f"and {count - KEPT_NAMES:,} more")

    def _added(self, reason: str, name: str) -> None:
        if self._writer is not None:
            self._writer.event(self._time_ns, f"skipped {reason}: {name}", "WARNING", "recorder")


def import_udacity(folder: Path, log: Path, *, rate_hz: float | None = None, overwrite: bool = False) -> Imported:
    """Write the Udacity recording in `folder` to `log`; its pictures byte for byte, its rows in their order.

    `rate_hz` is of one whose pictures' names tell no times: its rows are taken as so many a second, from 1970 on.
    Raises RecordingError if nothing in it can be used, and UserError if `log` exists and `overwrite` is off.
    """
    events = SkippedEvents()
    recording = UdacityFolder(folder, events.skipped, rate_hz)
    metadata = udacity_metadata(folder, rate_hz)
    row_count = pictures = 0
    rows = recording.rows()
    first = next(rows)  # without any, nothing is begun
    with LogWriter(log, metadata, overwrite=overwrite) as writer:
        all_rows = itertools.chain([first], rows)
        for row, paths in track(all_rows, f"importing {folder.name}", recording.line_count()):
            events.at(writer, row.time_ns)
            for camera, path in zip(COLUMNS, paths, strict=True):
                jpeg = _jpeg(path, events.skipped) if path is not None else None
                if jpeg is not None:
                    writer.picture(camera, row.time_ns, row_count, jpeg)
                    pictures += 1
            writer.vehicle(row.time_ns, row_count, vehicle_state(row))
            row_count += 1
    return Imported(log, row_count, pictures, events.skipped, writer.notices)


def udacity_metadata(folder: Path, rate_hz: float | None) -> dict[str, str]:
    """What the log of a Udacity recording says of itself."""
    metadata = {"source": "udacity", "recording": Path(os.path.realpath(folder)).name}
    if rate_hz is not None:
        metadata["clock"] = clock(rate_hz)
        metadata["start"] = "1970, because the recording does not tell it"
    return metadata


def _jpeg(path: str, skipped: Skipped) -> bytes | None:
    name = os.path.basename(path)  # noqa: PTH119  (a Path of each would take longer)
    try:
        jpeg = read_bounded(path, MOST_PICTURE_BYTES)
    except OSError:
        skipped.add(UNREADABLE, name)
        return None
    if not is_whole_jpeg(jpeg):
        skipped.add(NOT_WHOLE, name)
        return None
    return jpeg


def vehicle_state(row: Row) -> VehicleState:
    return VehicleState(steering=row.steering, throttle=row.throttle, brake=row.brake, speed_mph=row.speed_mph)
