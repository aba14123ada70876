"""Reads a LeRobot dataset of format v3."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from common.car import Camera
from common.errors import printable
from common.progress import track
from common.stretches import consecutive
from recorder.errors import LogError, RecordingError
from recorder.lerobot.dataset_format import LOG_CAR, LOG_NOT_RECORDED, LOG_NOT_RECORDED_S, LOG_TIME
from recorder.log.meant_gaps import MAX_S, MeantGap, earlier_seconds
from recorder.log.session_car import CAR_KEY, Car, car_in
from recorder.sources.imported_rows import FROM_1970, VIDEOS_ENCODED_ANEW, recording_metadata
from recorder.sources.lerobot_dataset import BATCH_ROWS, LeRobotFolder, open_dataset
from recorder.sources.lerobot_features import LeRobotFeatures, choose_features
from recorder.sources.lerobot_videos import CameraVideos
from recorder.sources.recorded_row import RawRecording, RecordedRow, UnreadablePictureError
from recorder.sources.settings import ImportSettings


def read_lerobot(folder: Path, settings: ImportSettings, car: Car | None = None) -> RawRecording:
    """The frames of the LeRobot dataset in `folder`: images byte for byte, frames of videos encoded anew.

    `settings` names the feature with the camera's pictures, and the steering's number, such as `action.steering`
    or `action.0`. Without them, the features' names decide. Episodes are drives. Our own exports keep their times
    and all digits; times of other datasets begin in 1970. `car`: our exports have it. Raises RecordingError.
    """
    dataset = open_dataset(folder)
    chosen = choose_features(dataset, settings)
    recording = RawRecording(
        folder,
        _metadata(dataset, chosen, _stored_car(dataset) if car is None and chosen.is_own else car),
        [],
        noun="frames",
        time_unit="ns" if chosen.has_log_time else settings.time_unit or "s",
        without_rows=f"{folder}: no frame of it can be used",
        notices=_notices(dataset, chosen, settings),
    )
    with contextlib.ExitStack() as opened:
        videos = {
            camera: opened.enter_context(CameraVideos(dataset, key))
            for camera, key in chosen.cameras.items()
            if dataset.features[key].dtype == "video"
        }
        counts: dict[int, int] = {}
        recording.rows = list(_frames(dataset, chosen, videos, counts))
        recording.missing = partial(_missing, dataset, counts)
        recording.opened = opened.pop_all()
    return recording


def _notices(dataset: LeRobotFolder, chosen: LeRobotFeatures, settings: ImportSettings) -> list[str]:
    notices = []
    if settings.steering is None and not chosen.is_own:
        notices.append(f"steering is the dataset's {printable(chosen.steering.label)} (--steering names another)")
    if chosen.missing:
        notices.append(f"no number has a name of these: {', '.join(chosen.missing)}")
    if any(dataset.features[key].dtype == "video" for key in chosen.cameras.values()):
        notices.append(VIDEOS_ENCODED_ANEW)
    return notices


def _metadata(dataset: LeRobotFolder, chosen: LeRobotFeatures, car: Car | None) -> dict[str, str]:
    clock = "recorded" if chosen.has_log_time else f"the dataset's timestamps, {dataset.fps:g} Hz"
    return recording_metadata("lerobot", dataset.root, car) | {
        "lerobot_version": dataset.version,
        "robot": dataset.robot,
        "image_topic": chosen.cameras.get("center", ""),
        "steering_topic": chosen.steering.label,
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
    dataset: LeRobotFolder,
    chosen: LeRobotFeatures,
    videos: Mapping[Camera, CameraVideos],
    counts: dict[int, int],
) -> Iterator[RecordedRow]:
    """The frames; `counts` gets their number in each episode."""
    images = {camera: key for camera, key in chosen.cameras.items() if camera not in videos}
    time_columns = [LOG_TIME] if chosen.has_log_time else []
    numbers = (number.feature for number in chosen.numbers)
    columns = list(dict.fromkeys(["episode_index", "timestamp", *time_columns, *numbers]))
    own_gaps = _own_gaps(dataset) if chosen.has_log_time else {}
    pictures = _Images(dataset, list(images.values()))
    last_episode: int | None = None
    batches = (
        (path, number, batch)
        for path in dataset.data_files()
        for number, batch in enumerate(dataset.rows(path, columns))
    )
    bar = f"reading {dataset.root.name}"
    for path, number, batch in track(batches, bar, math.ceil(dataset.frames / BATCH_ROWS)):
        try:
            rows = list(_rows(batch, chosen))
        except (pa.ArrowException, TypeError, ValueError, AttributeError) as error:
            why = printable(str(error).partition("\n")[0][:200])
            raise RecordingError(f"{path}: not of the shapes that meta/info.json promises ({why})") from None
        for at, (episode, time_s, log_time_ns, values) in enumerate(rows):
            counts[episode] = counts.get(episode, 0) + 1
            time = time_s if log_time_ns is None else log_time_ns
            row = RecordedRow(f"episode {episode}, frame {counts[episode] - 1}", time)
            row.steering, row.throttle, row.brake, row.speed = values
            if not chosen.has_log_time:
                row.episode = episode
            elif last_episode not in (None, episode):
                row.gap = own_gaps.get(episode)
            row.pictures = {
                **{camera: partial(pictures.read, path, number, at, key) for camera, key in images.items()},
                **{camera: partial(_frame, video, episode, time_s) for camera, video in videos.items()},
            }
            yield row
            last_episode = episode


def _frame(video: CameraVideos, episode: int, time_s: float) -> bytes:
    jpeg = video.jpeg(episode, time_s)
    if jpeg is None:
        raise UnreadablePictureError("frames without a picture")
    return jpeg


class _Images:
    """Reads the pictures of one batch of frames after the other."""

    def __init__(self, dataset: LeRobotFolder, keys: list[str]) -> None:
        self._dataset = dataset
        self._keys = keys
        self._place: tuple[Path, int] | None = None
        self._batches: Iterator[pa.RecordBatch] = iter(())
        self._columns: dict[str, list[Any]] = {}

    def read(self, path: Path, number: int, at: int, key: str) -> bytes:
        if self._place != (path, number):
            self._go_to(path, number)
        picture = self._columns[key][at]
        if picture is None:
            raise UnreadablePictureError("frames without a picture")
        return bytes(picture)

    def _go_to(self, path: Path, number: int) -> None:
        if self._place is None or self._place[0] != path or number < self._place[1]:
            self._batches = self._dataset.rows(path, self._keys)
            before = -1
        else:
            before = self._place[1]
        batch = next(itertools.islice(self._batches, number - before - 1, None))
        try:
            self._columns = {key: batch.column(key).field("bytes").to_pylist() for key in self._keys}
        except (pa.ArrowException, KeyError, TypeError, ValueError, AttributeError) as error:
            why = printable(str(error).partition("\n")[0][:200])
            raise RecordingError(f"{path}: not of the shapes that meta/info.json promises ({why})") from None
        self._place = path, number


def _rows(batch: pa.RecordBatch, chosen: LeRobotFeatures) -> Iterator[tuple[int, float, int | None, list[float]]]:
    """Episode, time in it, log time, and (steering, throttle, brake, speed) of each row."""
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
    if any(episode is None or time_s is None for episode, time_s in zip(episodes, times, strict=True)):
        raise ValueError("a frame without an episode or a timestamp")
    yield from zip(episodes, times, log_times, values, strict=True)


def _missing(dataset: LeRobotFolder, counts: Mapping[int, int]) -> Iterator[tuple[str, str]]:
    """Episodes and frames that meta/info.json counts, but no data file has."""
    episodes = sorted(counts)
    stretches = [(-1, -1), *consecutive(episodes), (dataset.episodes, dataset.episodes)]
    for (_, end), (start, _) in itertools.pairwise(stretches):
        if start > end + 1:
            name = f"episode {end + 1}" if start == end + 2 else f"episodes {end + 1} to {start - 1}"
            yield "episodes that are counted but missing", name
    missing = dataset.frames - sum(counts.values())
    if missing > 0:
        yield "frames that are counted but missing", f"{missing:,} of {dataset.frames:,}"
