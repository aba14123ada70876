"""Imports a DonkeyCar tub into a log."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from common import Skipped
from common.progress import track
from common.untrusted import read_bounded
from recorder.errors import RecordingError
from recorder.log.session_car import Car
from recorder.mcap.message_index import LAST_TIME_NS
from recorder.pictures.whole_picture import is_whole_jpeg
from recorder.sources.donkeycar_tub import Tub, TubRecord, finite, open_tub
from recorder.sources.frame_rate import describe_clock
from recorder.sources.imported_rows import (
    FROM_1970,
    Imported,
    ImportedRow,
    SkippedEvents,
    recording_metadata,
    vehicle_state,
    write_log,
)
from recorder.sources.udacity_recording import MAX_PICTURE_BYTES

DEFAULT_RATE_HZ: Final = 20  # of DonkeyCar's loop by default

_PICTURE = re.compile(r"[0-9]+_cam[_-]image_array_\.jpg")  # other cameras and depths have other names


class _UnusableRecordError(Exception):
    """A record cannot be used; the message is the reason."""


def import_tub(
    folder: Path, log: Path, *, rate_hz: float | None = None, car: Car | None = None, overwrite: bool = False
) -> Imported:
    """Write the DonkeyCar tub in `folder` to `log`; its pictures byte for byte, its records in order.

    DonkeyCar's angle is our steering. Its throttle is -1..1: values below 0 become the brake. Speed is NaN.
    `rate_hz`: records a second for a tub without times; 20 by default. Else as `import_udacity`.
    """
    events = SkippedEvents()
    skipped = events.skipped
    tub = open_tub(folder, skipped)
    is_timed = any(finite(record.values.get(tub.time_field)) is not None for record in tub.records(Skipped()))
    if is_timed and rate_hz is not None:
        raise RecordingError(f"{folder}: --rate: the tub's records have their times; leave it out")
    step_ms = None if is_timed else 1000 / (rate_hz or DEFAULT_RATE_HZ)
    frames = _frames(tub, step_ms, f"importing {folder.name}", skipped)
    clock = "recorded" if is_timed else f"{DEFAULT_RATE_HZ} Hz, because no record has a time"
    clock = clock if rate_hz is None else describe_clock(rate_hz)
    metadata = recording_metadata("donkeycar", folder, car) | {"tub_version": tub.version, "clock": clock}
    if tub.start_ns is None and (tub.is_time_from_start or not is_timed):
        metadata |= FROM_1970
    without_rows = f"{folder}: no usable record in this DonkeyCar tub"
    return write_log(log, metadata, frames, events, without_rows, overwrite=overwrite)


def _frames(tub: Tub, step_ms: float | None, bar: str, skipped: Skipped) -> Iterator[ImportedRow]:
    named: set[str] = set()
    for record in track(tub.records(skipped), bar, tub.count):
        try:
            yield _frame(tub, record, step_ms, named)
        except _UnusableRecordError as error:
            skipped.add(str(error), record.name)
    for name in sorted(tub.pictures.keys() - named):
        if _PICTURE.fullmatch(name):
            skipped.add("pictures without a record", name)


def _frame(tub: Tub, record: TubRecord, step_ms: float | None, named: set[str]) -> ImportedRow:
    picture = record.values.get("cam/image_array")
    name = re.split(r"[/\\]", picture)[-1] if isinstance(picture, str) else ""
    is_named_before = name in named
    named.add(name)
    if record.index in tub.deleted:
        raise _UnusableRecordError("deleted records")
    if record.values.get("user/mode") not in ("user", None):
        raise _UnusableRecordError("rows driven by DonkeyCar's pilot")
    angle, throttle = (_value(record, field) for field in ("user/angle", "user/throttle"))
    time_ns = _time_ns(tub, record, step_ms)
    if name not in tub.pictures:
        raise _UnusableRecordError("records without a picture")
    if is_named_before:  # the same picture twice could be on both sides of a split
        raise _UnusableRecordError("records with the picture of an earlier record")
    try:
        jpeg = read_bounded(tub.pictures[name], MAX_PICTURE_BYTES)
    except OSError:
        raise _UnusableRecordError("records with a picture that cannot be read") from None
    if not is_whole_jpeg(jpeg):
        raise _UnusableRecordError("records with a picture that is not a whole JPEG file")
    return ImportedRow(time_ns, vehicle_state(angle, throttle), [("center", jpeg)])


def _value(record: TubRecord, field: str) -> float:
    if record.values.get(field) is None:
        raise _UnusableRecordError(f"records without {field}")
    number = finite(record.values[field])
    if number is None:
        raise _UnusableRecordError(f"records with a {field} that is not a finite number")
    return float(number)


def _time_ns(tub: Tub, record: TubRecord, step_ms: float | None) -> int:
    """The time of a record: its own, or its index times `step_ms`."""
    zero_ns = (tub.start_ns or 0) if tub.is_time_from_start or step_ms is not None else 0
    ms = finite(record.values.get(tub.time_field) if step_ms is None else record.index)
    if ms is None:
        raise _UnusableRecordError("records without a time")
    ms *= 1 if step_ms is None else step_ms
    if not 0 <= ms <= LAST_TIME_NS or (time_ns := zero_ns + round(ms * 1_000_000)) > LAST_TIME_NS:
        raise _UnusableRecordError("records with a time that no log can hold")
    return time_ns
