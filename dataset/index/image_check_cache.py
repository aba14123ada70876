"""`index/looks/SESSION.json`: what looking at a log's pictures has found, kept so that it is done once.

Decoding every picture of a session takes tens of times as long as indexing it.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from common import atomic_file
from common.car import CAMERAS, Camera
from common.progress import progress_bar
from common.stretches import consecutive
from dataset.errors import naming
from dataset.index.frame_flags import Looked, Stretches
from recorder import Log, LogError
from recorder.log.message_index import UNCOMPRESSED
from recorder.log.row_quality import STANDING_MPH
from recorder.log.topics import camera_topic
from recorder.pictures.image_check import ImageCheck

LOOKS_FOLDER: Final = "looks"
_FORMAT: Final = 1
_MOST_BYTES: Final = 1 << 26


def look_at(log: Log, on_decoded: Callable[[int], object] = lambda count: None) -> Looked:
    """Decode every camera picture of a log, on all cores and with bounded memory.

    `on_decoded` is told how many more are done. Raises LogError if the log is damaged.
    """
    topics = {camera: camera_topic(camera) for camera in CAMERAS}
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
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
    return Looked(
        check.decoded,
        {camera: tuple(consecutive(broken[topic])) for camera, topic in topics.items() if topic in broken},
        {camera: frozen[topic] for camera, topic in topics.items() if frozen.get(topic)},
    )


def look_at_all(logs: Mapping[str, Path], index: Path, *, leave_out_unreadable: bool = False) -> list[str]:
    """Look at the pictures of the logs (by session) that `index` has no look of; the sessions looked at now.

    Each one that is done stays done, also if the work is then stopped. Raises LogError for a damaged log
    (`leave_out_unreadable`: it is left out, as it will be when the index is built).
    """
    unreadable = (LogError,) if leave_out_unreadable else ()
    pictures: dict[str, int] = {}
    for session, path in logs.items():
        with contextlib.suppress(*unreadable), Log(path) as log:
            if read_look(index, session, log.fingerprint) is None:
                counts = log.counts
                pictures[session] = sum(counts.get(camera_topic(camera), 0) for camera in CAMERAS)
    looked_at = []
    with progress_bar() as progress:
        task = progress.add_task("looking at pictures", total=sum(pictures.values()), note="")
        for session in pictures:
            with contextlib.suppress(*unreadable), Log(logs[session]) as log:
                looked = look_at(log, partial(progress.advance, task))
                write_look(index, session, log.fingerprint, looked)
                looked_at.append(session)
    return looked_at


def write_look(index: Path, session: str, fingerprint: str, looked: Looked) -> None:
    """Keep what looking at the log with this fingerprint has found."""
    entry = {
        "format": _FORMAT,
        "fingerprint": fingerprint,
        "pictures": looked.pictures,
        "broken": dict(looked.broken),
        "frozen": dict(looked.frozen),
    }
    path = _look_path(index, session)
    with naming(path), atomic_file(path, overwrite=True) as part:
        part.write_text(json.dumps(entry) + "\n", encoding="utf-8")


def read_look(index: Path, session: str, fingerprint: str) -> Looked | None:
    """What was found in the log with this fingerprint; None if nobody has looked, or the file is damaged."""
    path = _look_path(index, session)
    try:
        if path.is_symlink() or path.stat().st_size > _MOST_BYTES:
            return None
        entry: dict[str, Any] = json.loads(path.read_bytes())
        if entry["format"] != _FORMAT or entry["fingerprint"] != fingerprint:
            return None
        return Looked(_number(entry["pictures"]), _by_camera(entry["broken"]), _by_camera(entry["frozen"]))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _look_path(index: Path, session: str) -> Path:
    return index / LOOKS_FOLDER / f"{session}.json"


def _in_order_of_the_file(log: Log) -> Iterator[tuple[Camera, int, int, int, int, int]]:
    """Camera, row, log time, offset, length and chunk of each picture: a compressed chunk is unpacked once."""
    parts: list[tuple[NDArray[np.int64], ...]] = []
    for number, camera in enumerate(CAMERAS):
        found = log.pictures(camera_topic(camera))
        numbers = np.full(len(found.sequence), number, np.int64)
        parts.append((numbers, found.sequence, found.log_time_ns, found.offset, found.length, found.chunk))
    columns = [np.concatenate(part) for part in zip(*parts, strict=True)]
    offsets, chunks = columns[3], columns[5]
    order = np.lexsort((offsets, np.where(chunks == UNCOMPRESSED, offsets, chunks)))
    for at in order.tolist():
        number, row, time_ns, offset, length, chunk = (column[at].item() for column in columns)
        yield CAMERAS[number], row, time_ns, offset, length, chunk


def _number(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**62:
        raise ValueError(f"{value!r} is not a number of pictures")
    return value


def _by_camera(entry: dict[str, list[list[int]]]) -> dict[Camera, Stretches]:
    """Raises what `read_look` catches for anything but ascending stretches of known cameras."""
    found: dict[Camera, Stretches] = {}
    for camera in CAMERAS:
        stretches = tuple((_number(first), _number(last)) for first, last in entry.get(camera, []))
        if any(last < first for first, last in stretches) or any(
            later[0] <= earlier[1] for earlier, later in pairwise(stretches)
        ):
            raise ValueError(f"{camera}: not stretches in their order")
        found[camera] = stretches
    return found
