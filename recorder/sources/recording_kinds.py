"""The kinds of recordings that can be imported: recognising them, and calling their importers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from common.files import PART_SUFFIX
from common.untrusted import real_path
from recorder.errors import RecordingError
from recorder.log.session_car import Car
from recorder.sources.donkeycar_tub import is_tub
from recorder.sources.find_recording import is_udacity, recordings_near
from recorder.sources.import_csv import has_csv, import_csv
from recorder.sources.import_donkeycar import import_tub
from recorder.sources.import_mcap import McapTopics, import_mcap, is_mcap_or_bag, is_own_log
from recorder.sources.import_udacity import import_udacity
from recorder.sources.imported_rows import Imported
from recorder.sources.lerobot_dataset import is_lerobot
from recorder.sources.topic_flags import Topics


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
    """Write what is at `source` to `log`: a Udacity recording, a DonkeyCar tub, another program's MCAP log or a
    ROS 2 bag (which need `topics`), a LeRobot dataset (which may), or pictures with a csv (whose `columns` are as
    for `import_csv`). `rate_hz` is as for `import_tub`; `car` is what was driven.

    Raises RecordingError if it is none of them or nothing in it can be used, and UserError if `log` exists and
    `overwrite` is off.
    """
    topics = topics or Topics()
    if columns:
        if topics.image is not None or topics.steering is not None:
            raise RecordingError("--columns already names everything to import: leave out --image, --steering")
        return import_csv(
            source,
            log,
            columns,
            rate_hz=rate_hz,
            steering_scale=topics.steering_scale,
            car=car,
            overwrite=overwrite,
        )
    is_log = is_mcap_or_bag(source)
    is_dataset = not is_log and is_lerobot(source)
    is_donkeycar = not (is_log or is_dataset) and is_tub(source)
    if not (is_log or is_dataset or is_donkeycar or is_udacity(source)) and (hint := recordings_near(source)):
        raise RecordingError(f"{source}: not a recording;{hint}")
    if not (is_log or is_dataset or is_donkeycar or is_udacity(source)) and has_csv(source):
        raise RecordingError(
            f"{source}: pictures with a csv? Say what its columns are: --columns image=COLUMN steering=COLUMN"
            " --rate ROWS_A_SECOND"
        )
    if topics != Topics() and not (is_log or is_dataset):
        raise RecordingError(
            f"{source}: --image and --steering are for other programs' logs and LeRobot datasets; this is neither"
        )
    if rate_hz is not None and (is_log or is_dataset):
        what = "messages" if is_log else "frames"
        raise RecordingError(f"{source}: --rate: its {what} have their times; leave it out")
    if is_log:
        return import_mcap(source, log, _mcap_topics(source, log, topics), car=car, overwrite=overwrite)
    if is_dataset:
        from recorder.sources.import_lerobot import import_lerobot  # Arrow's parquet, OpenCV

        return import_lerobot(
            source,
            log,
            image=topics.image,
            steering=topics.steering,
            steering_scale=topics.steering_scale,
            car=car,
            overwrite=overwrite,
        )
    if is_donkeycar:
        return import_tub(source, log, rate_hz=rate_hz, car=car, overwrite=overwrite)
    return import_udacity(source, log, rate_hz=rate_hz, car=car, overwrite=overwrite)


def _mcap_topics(source: Path, log: Path, topics: Topics) -> McapTopics:
    if topics == Topics() and is_own_log(source):
        raise RecordingError(f"{source}: a log of this toolkit, {_what_to_do_instead(source, log)}")
    if topics.image is None or topics.steering is None:
        raise RecordingError(
            f"{source}: which topics? Give --image TOPIC and --steering TOPIC.FIELD;"
            f" `bc-log info {source}` lists them"
        )
    return McapTopics(topics.image, topics.steering, topics.steering_scale)


def refuse_to_watch(source: Path) -> None:
    """Raise RecordingError for what is no folder that the Udacity simulator may write into."""
    if not is_udacity(source) and (is_mcap_or_bag(source) or is_tub(source) or is_lerobot(source)):
        raise RecordingError(
            f"{source}: --watch follows folders of the Udacity simulator, which this is not; import it when it is"
            " finished, without --watch"
        )


def _what_to_do_instead(source: Path, log: Path) -> str:
    if source.suffix == PART_SUFFIX:
        return f"still unfinished: finish it with `bc-log recover {source}`"
    if real_path(source).parent == real_path(log).parent:
        return "and a session already: `bc-index` takes it in"
    return f"which is a session without being imported: copy it into {log.parent}/"
