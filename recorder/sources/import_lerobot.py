"""Imports a LeRobot dataset of format v3 into a log."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from common import Skipped
from common.car import Camera
from common.errors import printable
from common.progress import track
from common.stretches import consecutive
from recorder.errors import LogError, RecordingError
from recorder.lerobot.dataset_format import LOG_CAR, LOG_NOT_RECORDED, LOG_NOT_RECORDED_S, LOG_TIME
from recorder.log.meant_gaps import MAX_S, MeantGap, earlier_seconds
from recorder.log.session_car import CAR_KEY, Car, car_in
from recorder.mcap.message_index import LAST_TIME_NS
from recorder.pictures.decoding import is_whole_picture
from recorder.sources.imported_rows import (
    FROM_1970,
    NOT_WHOLE,
    STEERING_OUT_OF_RANGE,
    Imported,
    ImportedRow,
    SkippedEvents,
    recording_metadata,
    vehicle_state,
    write_log,
)
from recorder.sources.lerobot_dataset import BATCH_ROWS, LeRobotFolder, open_dataset
from recorder.sources.lerobot_features import LeRobotFeatures, choose_features
from recorder.sources.lerobot_videos import CameraVideos
from recorder.sources.settings import Topics
from recorder.sources.udacity_recording import MAX_PICTURE_BYTES

APART_NS: Final = 10_000_000_000  # between episodes without dates, so that each is a drive


def import_lerobot(
    folder: Path, log: Path, topics: Topics | None = None, *, car: Car | None = None, overwrite: bool = False
) -> Imported:
    """Write the LeRobot dataset in `folder` to `log`: images byte for byte, frames of videos encoded anew.

    `topics` names the feature with the camera's pictures, and the steering's number, such as `action.steering` or
    `action.0`. Without them, the features' names decide. Episodes are drives. Our own exports keep their times and
    all digits; times of other datasets begin in 1970. `car`: our exports have it. Else as `import_udacity`.
    """
    topics = topics or Topics()
    dataset = open_dataset(folder)
    chosen = choose_features(dataset, topics)
    events = SkippedEvents()
    with contextlib.ExitStack() as stack:
        videos = {
            camera: stack.enter_context(CameraVideos(dataset, key))
            for camera, key in chosen.cameras.items()
            if dataset.features[key].dtype == "video"
        }
        frames = _frames(dataset, chosen, videos, events.skipped)
        log_car = _stored_car(dataset) if car is None and chosen.is_own else car
        metadata = _metadata(dataset, chosen, topics.steering_scale, log_car)
        without_rows = f"{folder}: no frame of it can be used"
        imported = write_log(log, metadata, frames, events, without_rows, overwrite=overwrite)
    notices = []
    if topics.steering is None and not chosen.is_own:
        notices.append(f"steering is the dataset's {printable(chosen.steering.label)} (--steering names another)")
    if chosen.missing:
        notices.append(f"no number has a name of these: {', '.join(chosen.missing)}")
    if videos:
        notices.append("decoded from videos and encoded anew: these are not the camera's original pictures")
    return replace(imported, notices=[*notices, *imported.notices])


def _metadata(
    dataset: LeRobotFolder, chosen: LeRobotFeatures, steering_scale: float, car: Car | None
) -> dict[str, str]:
    clock = "recorded" if chosen.has_log_time else f"the dataset's timestamps, {dataset.fps:g} Hz"
    return recording_metadata("lerobot", dataset.root, car) | {
        "lerobot_version": dataset.version,
        "robot": dataset.robot,
        "image_topic": chosen.cameras.get("center", ""),
        "steering_topic": chosen.steering.label,
        "steering_scale": repr(steering_scale),
        "clock": clock,
        **({} if chosen.has_log_time else FROM_1970),
    }


def _stored_car(dataset: LeRobotFolder) -> Car | None:
    """The car in an export of ours, if all episodes have the same car."""
    try:
        cars = set(dataset.episode_table([LOG_CAR])[LOG_CAR].to_pylist())
    except RecordingError:  # of an earlier version
        return None
    session = {CAR_KEY: str(cars.pop())} if len(cars) == 1 and cars != {""} else {}
    try:
        return car_in(session, dataset.root)
    except LogError as error:
        raise RecordingError(str(error)) from None


def _own_gaps(dataset: LeRobotFolder) -> dict[int, MeantGap]:
    """The times left out on purpose before episodes of an export of ours, by episode."""
    columns = ["episode_index", LOG_NOT_RECORDED, LOG_NOT_RECORDED_S]
    for names in (columns, columns[:2]):
        try:
            rows = dataset.episode_table(names).to_pylist()
        except RecordingError:  # of an earlier version
            continue
        gaps = {}
        for row in rows:
            why = str(row[LOG_NOT_RECORDED])
            seconds = row.get(LOG_NOT_RECORDED_S, earlier_seconds(why))
            if isinstance(seconds, float) and 0 < seconds < MAX_S:
                gaps[row["episode_index"]] = MeantGap(seconds, why.partition(" s, ")[2] or why)
        return gaps
    return {}


def _frames(
    dataset: LeRobotFolder, chosen: LeRobotFeatures, videos: dict[Camera, CameraVideos], skipped: Skipped
) -> Iterator[ImportedRow]:
    images = {camera: key for camera, key in chosen.cameras.items() if camera not in videos}
    time_columns = [LOG_TIME] if chosen.has_log_time else []
    numbers = (number.feature for number in chosen.numbers)
    columns = list(dict.fromkeys(["episode_index", "timestamp", *time_columns, *numbers, *images.values()]))
    clock, counts = _Clock(), dict[int, int]()
    another_episode = MeantGap(APART_NS / 1e9, "another episode begins")
    own_gaps = _own_gaps(dataset) if chosen.has_log_time else {}
    last_episode: int | None = None
    bar = f"importing {dataset.root.name}"
    batches = ((path, batch) for path in dataset.data_files() for batch in dataset.rows(path, columns))
    for path, batch in track(batches, bar, math.ceil(dataset.frames / BATCH_ROWS)):
        try:
            rows = list(_rows(batch, chosen, images))
        except (pa.ArrowException, TypeError, ValueError, AttributeError) as error:
            why = printable(str(error).partition("\n")[0][:200])
            raise RecordingError(f"{path}: not of the shapes that meta/info.json promises ({why})") from None
        for episode, time_s, log_time_ns, values, pictures in rows:
            counts[episode] = counts.get(episode, 0) + 1
            name = f"episode {episode}, frame {counts[episode] - 1}"
            time_ns = log_time_ns if chosen.has_log_time else clock.time_ns(episode, time_s)
            if time_ns is None or not 0 <= time_ns <= LAST_TIME_NS:
                skipped.add("frames with a time that no log can hold", name)
                continue
            for camera, video in videos.items():
                if (jpeg := video.jpeg(episode, time_s)) is not None:
                    pictures[camera] = jpeg
            sound = {camera: picture for camera, picture in pictures.items() if _is_sound(picture)}
            if len(sound) < len(pictures):
                skipped.add(NOT_WHOLE, name)
            if not sound:
                skipped.add("frames without a picture", name)
                continue
            if not math.isfinite(values[0]):
                skipped.add("frames whose steering is not a finite number", name)
                continue
            if abs(values[0]) > 1:
                skipped.add(STEERING_OUT_OF_RANGE, f"{name}: {values[0]:g}")
            gap = own_gaps.get(episode) if chosen.has_log_time else another_episode
            before = gap if last_episode not in (None, episode) else None
            yield ImportedRow(time_ns, vehicle_state(*values), sound.items(), before)
            last_episode = episode
    _skip_missing(dataset, counts, skipped)


def _rows(
    batch: pa.RecordBatch, chosen: LeRobotFeatures, images: dict[Camera, str]
) -> Iterator[tuple[int, float, int | None, list[float], dict[Camera, bytes]]]:
    """Episode, time in it, log time, (steering, throttle, brake, speed) and pictures of each row."""
    episodes = batch.column("episode_index").cast(pa.int64()).to_pylist()
    times = batch.column("timestamp").cast(pa.float64()).to_pylist()
    log_times: list[Any] = [None] * len(episodes)
    if chosen.has_log_time:
        log_times = batch.column(LOG_TIME).cast(pa.int64()).to_pylist()
    nothing, unknown = np.zeros(len(episodes)), np.full(len(episodes), math.nan)
    numbers = [
        chosen.steering.values(batch),
        nothing if chosen.throttle is None else chosen.throttle.values(batch),
        nothing if chosen.brake is None else chosen.brake.values(batch),
        unknown if chosen.speed_mph is None else chosen.speed_mph.values(batch),
    ]
    values = np.stack(numbers, axis=1).tolist()
    pictures = {camera: batch.column(key).field("bytes").to_pylist() for camera, key in images.items()}
    if any(episode is None or time_s is None for episode, time_s in zip(episodes, times, strict=True)):
        raise ValueError("a frame without an episode or a timestamp")
    for at, (episode, time_s) in enumerate(zip(episodes, times, strict=True)):
        row_pictures = {camera: column[at] for camera, column in pictures.items() if column[at] is not None}
        yield episode, time_s, log_times[at], values[at], row_pictures


class _Clock:
    """Gives episodes times one after the other, from 1970 on. A dataset has only seconds in each episode."""

    def __init__(self) -> None:
        self._episode: int | None = None
        self._start_ns = self._last_ns = 0

    def time_ns(self, episode: int, time_s: float) -> int | None:
        if not math.isfinite(time_s) or not 0 <= time_s < 1e9:
            return None
        if episode != self._episode:
            self._start_ns = 0 if self._episode is None else self._last_ns + APART_NS
            self._episode = episode
        # in a long episode, 32-bit times are precise to some tens of microseconds
        time_ns = self._start_ns + round(time_s * 1e6) * 1000
        self._last_ns = max(self._last_ns, time_ns)
        return time_ns


def _is_sound(picture: object) -> bool:
    return isinstance(picture, bytes) and len(picture) <= MAX_PICTURE_BYTES and is_whole_picture(picture)


def _skip_missing(dataset: LeRobotFolder, counts: dict[int, int], skipped: Skipped) -> None:
    """Count episodes and frames as skipped that meta/info.json counts, but no data file has."""
    episodes = sorted(counts)
    stretches = [(-1, -1), *consecutive(episodes), (dataset.episodes, dataset.episodes)]
    for (_, end), (start, _) in itertools.pairwise(stretches):
        if start > end + 1:
            name = f"episode {end + 1}" if start == end + 2 else f"episodes {end + 1} to {start - 1}"
            skipped.add("episodes that are counted but missing", name)
    missing = dataset.frames - sum(counts.values())
    if missing > 0:
        skipped.add("frames that are counted but missing", f"{missing:,} of {dataset.frames:,}")
