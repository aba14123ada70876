"""Rows of a recording on their way into a log, as the importers of all kinds have them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from common.car import Camera
from recorder.bc_pb2 import VehicleState
from recorder.log.meant_gaps import MeantGap
from recorder.log.writer import LogWriter
from recorder.sources.import_result import SkippedEvents

STEERING_OUT_OF_RANGE: Final = (
    "rows with steering beyond -1..1 (kept, but an index leaves them out; is --steering-scale right?)"
)
"""The remark on such rows, which are not left out."""


@dataclass(frozen=True)
class ImportedRow:
    time_ns: int
    state: VehicleState
    pictures: Mapping[Camera, bytes]  # JPEG or PNG, byte for byte
    gap: MeantGap | None = None  # before it


def write_rows(writer: LogWriter, rows: Iterable[ImportedRow], events: SkippedEvents) -> tuple[int, int]:
    """Write rows, numbered from 0, and events of what is left out between them; how many rows and pictures."""
    count = pictures = 0
    for row in rows:
        events.at(writer, row.time_ns)
        for camera, picture in row.pictures.items():
            writer.picture(camera, row.time_ns, count, picture)
        writer.vehicle(row.time_ns, count, row.state, row.gap)
        count += 1
        pictures += len(row.pictures)
    return count, pictures
