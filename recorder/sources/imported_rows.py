"""Writes the rows of any recording to a log, for all importers."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from common import Skipped
from common.car import Camera
from common.errors import MAX_KEPT_NAMES, counted
from recorder.bc_pb2 import VehicleState
from recorder.errors import RecordingError
from recorder.log.meant_gaps import MeantGap
from recorder.log.session_car import Car, metadata_of
from recorder.log.writer import LogWriter

STEERING_OUT_OF_RANGE: Final = (
    "rows with steering beyond -1..1 (kept, but an index leaves them out; is --steering-scale right?)"
)
"""The remark on these rows, which are kept."""
NOT_WHOLE: Final = "pictures that are not whole JPEG or PNG files"
_MAX_BACK: Final = 0.1  # share of the rows; recordings of several drives go back a few times
FROM_1970: Final = {"start": "1970, because the recording does not have it"}
"""Metadata of a log whose recording has no date."""


@dataclass(frozen=True)
class Imported:
    path: Path
    rows: int
    pictures: int
    skipped: Skipped
    notices: Sequence[str] = ()  # lines about its content
    others: Sequence[Imported] = ()  # of further simulators at the same time


class SkippedEvents:
    """Counts what an import skips, and writes an event about each to its log.

    Events before the first row wait for this row. After a thousand events of a kind, the rest is only counted.
    """

    def __init__(self) -> None:
        self.skipped = Skipped(self._added)
        self._writer: LogWriter | None = None
        self._time_ns = 0

    def at(self, writer: LogWriter, time_ns: int) -> None:
        """Set the time of the following events: that of their row."""
        is_first = self._writer is None
        self._writer, self._time_ns = writer, time_ns
        if is_first:
            for reason, name in self.skipped:
                self._added(reason, name)
            for reason, count in self.skipped.counts.items():
                if count > MAX_KEPT_NAMES:
                    self._added(reason, f"and {count - MAX_KEPT_NAMES:,} more")

    def _added(self, reason: str, name: str) -> None:
        if self._writer is not None:
            self._writer.event(self._time_ns, f"skipped {reason}: {name}", "WARNING", "recorder")


@dataclass(frozen=True)
class ImportedRow:
    time_ns: int
    state: VehicleState
    pictures: Iterable[tuple[Camera, bytes]]  # JPEG or PNG, byte for byte
    gap: MeantGap | None = None  # before the row


def recording_metadata(source: str, recording: Path, car: Car | None) -> dict[str, str]:
    """The metadata about the origin of an imported log."""
    return {"source": source, "recording": Path(os.path.realpath(recording)).name} | metadata_of(car)


def vehicle_state(
    steering: float, throttle: float = 0.0, brake: float = 0.0, speed_mph: float = math.nan
) -> VehicleState:
    """A state of the car. A throttle below 0 brakes. Pedals that are not finite become 0."""
    throttle, brake = (value if math.isfinite(value) else 0.0 for value in (throttle, brake))
    brake = max(0.0, brake, -throttle)
    return VehicleState(steering=steering, throttle=max(0.0, throttle), brake=brake, speed_mph=speed_mph)


def write_log(
    log: Path,
    metadata: dict[str, str],
    rows: Iterator[ImportedRow],
    events: SkippedEvents,
    without_rows: str = "",
    *,
    warnings: Sequence[str] = (),
    overwrite: bool,
) -> Imported:
    """Write rows, numbered from 0, with events about skipped ones. `warnings` become events at the first row.

    Raises RecordingError if there is no row (its text begins with `without_rows`), or no picture: then no log is
    created.
    """
    first = next(rows, None)
    if first is None:
        raise RecordingError(f"{without_rows}{events.skipped.error_suffix()}")
    count = pictures = back = 0
    last_ns = first.time_ns
    with LogWriter(log, metadata, overwrite=overwrite) as writer:
        for text in warnings:
            writer.event(first.time_ns, text, "WARNING", "recorder")
        for row in itertools.chain([first], rows):
            events.at(writer, row.time_ns)
            for camera, picture in row.pictures:
                writer.picture(camera, row.time_ns, count, picture)
                pictures += 1
            writer.vehicle(row.time_ns, count, row.state, row.gap)
            count += 1
            back += row.time_ns < last_ns
            last_ns = row.time_ns
        if not pictures:  # inside, so that the log is discarded
            raise RecordingError(
                f"{metadata['recording']}: no picture of it can be used{events.skipped.error_suffix()}"
            )
    notices = [*warnings, *writer.notices]
    if back > _MAX_BACK * count:
        shuffled = "are the rows shuffled? Then sort them by time, and import them with --force"
        notices.append(f"time goes back {counted(back, 'time')}, and each begins a new drive; {shuffled}")
    return Imported(log, count, pictures, events.skipped, notices)
