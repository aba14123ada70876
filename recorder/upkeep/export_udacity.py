"""Write a log as a recording of Udacity's training mode: `driving_log.csv` and `IMG/`."""

from __future__ import annotations

import contextlib
from datetime import UTC, datetime, timedelta
from pathlib import Path

from common import Skipped, UserError
from common.car import CAMERAS
from common.files import new_folder
from common.location import Location
from common.progress import track
from recorder.errors import LogError
from recorder.log.reader import Log
from recorder.log.tags import EXCLUDE, TaggedRows, tags_of
from recorder.pictures.picture_size import PNG_START
from recorder.rows.row_quality import States
from simulator.protocol.udacity_writer import CSV_CAMERAS


def export_udacity(path: Location, folder: Path) -> tuple[int, Skipped]:
    """Write the rows of a log that have a picture of the centre camera, except those tagged `exclude`, to a new
    folder. Returns their number, and what was skipped. Pictures stay byte for byte; the csv names them relative to
    the folder. Raises LogError if nothing can be written, UserError if the folder exists."""
    skipped, written = Skipped(), 0
    try:
        with Log(path) as log, new_folder(folder) as part, (part / "driving_log.csv").open("w", newline="") as csv:
            (part / "IMG").mkdir()
            states = States.of(log.vehicle())
            excluded = TaggedRows(tags_of(log), EXCLUDE)
            for at in track(range(len(states.row)), f"exporting to {folder.name}", len(states.row)):
                row = int(states.row[at])
                if excluded.cover(row, row):
                    skipped.add("rows tagged exclude", f"row {row}")
                    continue
                pictures = {}
                for camera in CAMERAS:
                    with contextlib.suppress(LogError):
                        pictures[camera] = log.picture(row, camera)
                if "center" not in pictures:
                    skipped.add("rows without a picture of the centre camera", f"row {row}")
                    continue
                if pictures["center"].startswith(PNG_START):
                    raise LogError(
                        f"{path}: its pictures are PNG, and Udacity's are JPEG; export it with --lerobot"
                    )
                moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=int(states.time_ns[at]) // 1000)
                stamp = f"{moment:%Y_%m_%d_%H_%M_%S}_{moment.microsecond // 1000:03d}"
                names = [f"IMG/{camera}_{stamp}.jpg" if camera in pictures else "" for camera in CSV_CAMERAS]
                if (part / names[0]).exists():
                    skipped.add("rows in the same millisecond as the one before", f"row {row}")
                    continue
                for camera, name in zip(CSV_CAMERAS, names, strict=True):
                    if name:
                        (part / name).write_bytes(pictures[camera])
                columns = states.steering, states.throttle, states.brake, states.speed_mph
                csv.write(",".join([*names, *(f"{column[at]:.7g}" for column in columns)]) + "\n")
                written += 1
            if not written:
                raise LogError(f"{path}: no row can be exported{skipped.error_suffix()}")
    except OSError as error:
        raise UserError(f"{folder}: cannot be written ({error.strerror})") from None
    return written, skipped
