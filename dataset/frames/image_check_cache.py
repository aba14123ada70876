"""`index/looks/SESSION.json`: the results of a check of all pictures of a log, so that a log is checked only once.

Decoding all pictures of a session takes tens of times as long as indexing the session.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from common import atomic_file
from common.car import CAMERAS, Camera
from common.location import Location
from common.process_settings import usable_cores
from common.progress import progress_bar
from common.stretches import consecutive, stretches
from common.tasks import Tasks, one_by_one
from dataset.errors import index_write_errors, log_problem
from dataset.frames.frame_flags import ImageFindings
from recorder import Log, LogError
from recorder.log.known_lag import find_lag, lacks_lag
from recorder.log.road_places import states_of
from recorder.mcap.message_index import UNCOMPRESSED
from recorder.pictures.image_check import ImageCheck
from recorder.rows.row_quality import STANDING_MPH
from recorder.topics import camera_topic

IMAGE_CHECKS_FOLDER: Final = "looks"
_FORMAT: Final = 1


def check_images(
    log: Log, on_decoded: Callable[[int], object] = lambda count: None, threads: int | None = None
) -> ImageFindings:
    """Decode all camera pictures of a log, in `threads` (by default one for each core) and with bounded memory.
    Compare the car's turning, by its poses or else its pictures, with the steering. If the steering's lag is
    unknown, measure it, and keep it next to the log.

    `on_decoded` is called with the number of pictures decoded since the last call. Raises LogError if the log is
    damaged.
    """
    from recorder.seen.picture_stretches import against_pictures  # OpenCV

    topics = {camera: camera_topic(camera) for camera in CAMERAS}
    with ThreadPoolExecutor(threads or usable_cores()) as pool:
        check = ImageCheck(pool, on_decoded)
        for camera, row, time_ns, offset, length, chunk in _in_order_of_the_file(log):
            check.add(topics[camera], row, time_ns, log.read(offset, length, chunk))
        check.finish()
    standing: set[tuple[int, int]] = set()
    if any(pictures.has_repeated for pictures in check.pictures.values()):
        standing = {
            (message.sequence, message.log_time_ns)
            for message, state in log.vehicle_states()
            if state.speed_mph < STANDING_MPH
        }
    broken: dict[str, list[int]] = {}
    for topic, position in check.broken:
        broken.setdefault(topic, []).append(position)
    frozen = {topic: tuple(pictures.frozen(standing)) for topic, pictures in check.pictures.items()}
    return ImageFindings(
        check.decoded,
        {camera: tuple(consecutive(broken[topic])) for camera, topic in topics.items() if topic in broken},
        {camera: frozen[topic] for camera, topic in topics.items() if frozen.get(topic)},
        tuple(stretches(against_pictures(log, states_of(log), lambda count: on_decoded(0)))),
        find_lag(log),
    )


def check_all_images(
    logs: Mapping[str, Location], index: Path, *, leave_out_unreadable: bool = False, tasks: Tasks = one_by_one
) -> list[str]:
    """Check the pictures of the logs (by session) that `index` has no results for; returns these sessions.

    The results of each log are written when its check is done, so that they stay if the work is stopped later.
    Raises LogError if a log is damaged; with `leave_out_unreadable`, skips the log. On this machine, the check of
    a log uses all cores; on a cluster, each log is one of the `tasks`.
    """
    unreadable = (LogError,) if leave_out_unreadable else ()
    pictures: dict[str, int] = {}
    for session, path in logs.items():
        with contextlib.suppress(*unreadable), Log(path) as log:
            findings = read_image_check(index, session, log.fingerprint)
            if findings is None or findings.against is None or (findings.lag is None and lacks_lag(log)):
                counts = log.counts
                pictures[session] = sum(counts.get(camera_topic(camera), 0) for camera in CAMERAS)
    names, checked = list(pictures), []
    with progress_bar() as progress:
        bar = progress.add_task("checking pictures", total=sum(pictures.values()), note="")
        options = (None, partial(progress.advance, bar)) if tasks is one_by_one else (1,)
        for number, error in tasks(_check_log, [(name, logs[name], index, *options) for name in names]):
            if error is None:
                checked.append(names[number])
            elif not unreadable:
                raise error
            if tasks is not one_by_one:
                progress.advance(bar, pictures[names[number]])
    return sorted(checked)


def _check_log(
    session: str,
    path: Location,
    index: Path,
    threads: int | None,
    on_decoded: Callable[[int], object] = lambda count: None,
) -> LogError | None:
    try:
        with Log(path) as log:
            write_image_check(index, session, log.fingerprint, check_images(log, on_decoded, threads))
    except Exception as error:
        return log_problem(path, error)
    return None


def write_image_check(index: Path, session: str, fingerprint: str, findings: ImageFindings) -> None:
    stored = {"format": _FORMAT, "fingerprint": fingerprint, **msgspec.to_builtins(findings)}
    path = image_check_path(index, session)
    with index_write_errors(path), atomic_file(path, overwrite=True) as part:
        part.write_text(json.dumps(stored) + "\n", encoding="utf-8")


def read_image_check(index: Path, session: str, fingerprint: str) -> ImageFindings | None:
    """The results for the log with this fingerprint; None if their file is missing, damaged or of another log."""
    try:
        stored = json.loads(image_check_path(index, session).read_bytes())
        findings = msgspec.convert(stored, ImageFindings)
    except (OSError, ValueError):
        return None
    return findings if (stored.get("format"), stored.get("fingerprint")) == (_FORMAT, fingerprint) else None


def image_check_path(index: Path, session: str) -> Path:
    return index / IMAGE_CHECKS_FOLDER / f"{session}.json"


def _in_order_of_the_file(log: Log) -> Iterator[tuple[Camera, int, int, int, int, int]]:
    """Yield camera, row, log time, offset, length and chunk of each picture, in the order of the file, so that
    each compressed chunk is decompressed once."""
    parts: list[tuple[NDArray[np.int64], ...]] = []
    for number, camera in enumerate(CAMERAS):
        pictures = log.pictures(camera_topic(camera))
        numbers = np.full(len(pictures.sequence), number, np.int64)
        parts.append(
            (numbers, pictures.sequence, pictures.log_time_ns, pictures.offset, pictures.length, pictures.chunk)
        )
    columns = [np.concatenate(part) for part in zip(*parts, strict=True)]
    offsets, chunks = columns[3], columns[5]
    order = np.lexsort((offsets, np.where(chunks == UNCOMPRESSED, offsets, chunks)))
    for at in order.tolist():
        number, row, time_ns, offset, length, chunk = (column[at].item() for column in columns)
        yield CAMERAS[number], row, time_ns, offset, length, chunk
