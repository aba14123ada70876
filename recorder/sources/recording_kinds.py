"""Recognises the kind of a recording, and calls its importer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from common.files import refuse_existing
from recorder.errors import RecordingError
from recorder.log.session_car import Car
from recorder.sources.find_recording import is_udacity, kind_of, recordings_near
from recorder.sources.import_csv import has_csv, import_csv
from recorder.sources.import_donkeycar import import_tub
from recorder.sources.import_mcap import import_mcap
from recorder.sources.import_udacity import import_udacity
from recorder.sources.imported_rows import Imported
from recorder.sources.settings import Topics
from recorder.sources.udacity_recording import CSV_NAME


def import_recording(
    source: Path,
    log: Path,
    topics: Topics | None = None,
    *,
    columns: Sequence[str] = (),
    rate_hz: float | None = None,
    car: Car | None = None,
    overwrite: bool = False,
) -> Imported:
    """Import a recording of any kind, `source`, to `log`.

    `topics`: for another program's MCAP log or a ROS 2 bag; optional for a LeRobot dataset. `columns`: for
    pictures with a csv, as for `import_csv`. `rate_hz`: as for `import_tub`. Else as `import_udacity`.
    """
    refuse_existing(log, overwrite)  # before minutes of reading
    topics = topics or Topics()
    if columns:
        if topics.image is not None or topics.steering is not None:
            raise RecordingError("--columns already names everything to import: leave out --image, --steering")
        scale = topics.steering_scale
        return import_csv(
            source, log, columns, rate_hz=rate_hz, steering_scale=scale, car=car, overwrite=overwrite
        )
    kind = kind_of(source)
    if not kind and (hint := recordings_near(source)):
        raise RecordingError(f"{source}: not a recording;{hint}")
    if not kind and has_csv(source):
        raise RecordingError(
            f"{source}: pictures with a csv? Say what its columns are: --columns image=COLUMN steering=COLUMN"
            f" --rate ROWS_A_SECOND; or, if Udacity's simulator wrote it, name it {CSV_NAME}"
        )
    if topics != Topics() and kind not in ("log", "lerobot"):
        raise RecordingError(
            f"{source}: --image and --steering are for other programs' logs and LeRobot datasets; this is neither"
        )
    if rate_hz is not None and kind in ("log", "lerobot"):
        noun = "messages" if kind == "log" else "frames"
        raise RecordingError(f"{source}: --rate: its {noun} have their times; leave it out")
    if kind == "log":
        return import_mcap(source, log, topics, car=car, overwrite=overwrite)
    if kind == "lerobot":
        from recorder.sources.import_lerobot import import_lerobot  # Arrow's parquet, OpenCV

        return import_lerobot(source, log, topics, car=car, overwrite=overwrite)
    import_it = import_tub if kind == "tub" else import_udacity
    return import_it(source, log, rate_hz=rate_hz, car=car, overwrite=overwrite)


def refuse_to_watch(source: Path) -> None:
    """Raise RecordingError unless the Udacity simulator may write into the folder `source`."""
    if not is_udacity(source) and kind_of(source):
        raise RecordingError(
            f"{source}: --watch follows folders of the Udacity simulator, which this is not; import it when it is"
            " finished, without --watch"
        )
