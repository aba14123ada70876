"""Imports a recording of the Udacity simulator into a log."""

from __future__ import annotations

from pathlib import Path

from recorder.log.session_car import Car
from recorder.sources.imported_rows import Imported
from recorder.sources.recording_kinds import import_recording
from recorder.sources.settings import ImportSettings


def import_udacity(
    folder: Path, log: Path, *, rate_hz: float | None = None, car: Car | None = None, overwrite: bool = False
) -> Imported:
    """Write the Udacity recording in `folder` to `log`; its pictures byte for byte, its rows in order.

    `rate_hz`: rows a second, from 1970 on, for a recording whose pictures' names hold no times. `car`: the
    recorded car, if it is not Udacity's. Raises RecordingError if nothing in it can be used, and UserError if
    `log` exists and `overwrite` is off.
    """
    settings = ImportSettings(rate=rate_hz)
    return import_recording(folder, log, settings, kind="udacity", car=car, overwrite=overwrite)
