"""Reads a LeRobot dataset of format v3: finds steering, pedals, speed and cameras by flags or names."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from common.car import CAMERAS, MPS_PER_MPH, Camera
from common.errors import did_you_mean, printable
from common.progress import track
from common.stretches import consecutive
from recorder.errors import LogError, RecordingError
from recorder.lerobot.dataset_format import (
    ACTION_NAMES,
    LOG_CAR,
    LOG_NOT_RECORDED,
    LOG_NOT_RECORDED_S,
    LOG_TIME,
    LOG_VEHICLE,
    Feature,
    image_key,
)
from recorder.log.meant_gaps import MAX_S, MeantGap, earlier_seconds
from recorder.log.session_car import CAR_KEY, Car, car_in
from recorder.sources.imported_rows import (
    FROM_1970,
    VIDEOS_ENCODED_ANEW,
    RawRecording,
    RecordedRow,
    UnreadablePictureError,
    recording_metadata,
)
from recorder.sources.lerobot_dataset import BATCH_ROWS, CameraVideos, LeRobotFolder, open_dataset
from recorder.sources.mcap_recording import side_cameras
from recorder.sources.settings import ImportSettings

_NUMBERS: Final = ("float16", "float32", "float64", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32")
_THROTTLE: Final = ("throttle", "gas", "accelerator")
_MPH: Final = {"speed_mph": 1.0, "speed_mps": 1 / MPS_PER_MPH, "speed_kmh": 1000 / 3600 / MPS_PER_MPH}
"""The factor to mph, by a speed's name. Speeds of unknown unit are not used."""
_CENTER: Final = ("center", "centre", "front")


@dataclass(frozen=True)
class FeatureNumber:
    """One number of a feature: `action.steering`, `action.0`, or a feature with a single number."""

    feature: str
    index: int | None
    label: str
    scale: float = 1.0

    @property
    def word(self) -> str:
        """The last part of its name, in small letters, without the `.pos` that LeRobot gives to positions."""
        return self.label.lower().removesuffix(".pos").rpartition(".")[2]

    def values(self, batch: pa.RecordBatch) -> NDArray[np.float64]:
        """Its values (N,), NaN if missing. Raises ArrowException if the column has another shape."""
        column = batch.column(self.feature)
        if self.index is not None:
            column = pc.list_element(column, self.index)
        cast = pc.cast(column, pa.float64(), safe=False)
        values: NDArray[np.float64] = cast.to_numpy(zero_copy_only=False)
        return values * self.scale


@dataclass(frozen=True)
class LeRobotFeatures:
    steering: FeatureNumber
    throttle: FeatureNumber | None
    brake: FeatureNumber | None
    speed_mph: FeatureNumber | None
    cameras: Mapping[Camera, str]
    has_log_time: bool
    """A column has the true times, as in an export of ours."""

    @property
    def is_own(self) -> bool:
        """True for an export of ours, which has all digits of its log."""
        return self.steering.feature == LOG_VEHICLE

    @property
    def missing(self) -> list[str]:
        """What was not found, and what a log has instead."""
        instead = {"throttle": "0", "brake": "0", "speed_mph": "unknown"}
        return [f"{name} is {value}" for name, value in instead.items() if getattr(self, name) is None]

    @property
    def numbers(self) -> list[FeatureNumber]:
        numbers = (self.steering, self.throttle, self.brake, self.speed_mph)
        return [number for number in numbers if number is not None]


def choose_features(dataset: LeRobotFolder, settings: ImportSettings) -> LeRobotFeatures:
    """`settings`: the user's choice. Raises RecordingError if a feature cannot be found."""
    is_own = LOG_TIME in dataset.features and dataset.features.get(LOG_VEHICLE, Feature("", ())).shape == (4,)
    cameras = _cameras(dataset, settings)
    if is_own and settings.steering is None:
        numbers = [
            FeatureNumber(LOG_VEHICLE, at, f"{LOG_VEHICLE}.{name}")
            for at, name in enumerate((*ACTION_NAMES, "speed_mph"))
        ]
        return LeRobotFeatures(numbers[0], numbers[1], numbers[2], numbers[3], cameras, True)
    chosen = _steering_by_name(dataset) if settings.steering is None else _number(dataset, settings.steering)
    return LeRobotFeatures(
        chosen,
        _pedal(dataset, chosen, _THROTTLE),
        _pedal(dataset, chosen, ("brake",)),
        _speed(dataset),
        cameras,
        LOG_TIME in dataset.features,
    )


def _cameras(dataset: LeRobotFolder, settings: ImportSettings) -> dict[Camera, str]:
    keys = dataset.image_keys
    if settings.image is not None:
        cameras: dict[Camera, str] = {"center": settings.image, **side_cameras(settings)}
        for camera, key in cameras.items():
            if key not in keys:
                flag = "--image" if camera == "center" else "--camera"
                raise RecordingError(
                    f"{dataset.root}: no pictures {printable(key)!r} for {flag}; it has {_listed(keys)}"
                )
        return cameras
    if image_key("center") in keys:
        return {camera: image_key(camera) for camera in CAMERAS if image_key(camera) in keys}
    middle = [key for key in keys if key.rpartition(".")[2] in _CENTER]
    for candidates in (middle, keys):
        if len(candidates) == 1:
            return {"center": candidates[0]}
    if not keys:
        raise RecordingError(f"{dataset.root}: it has no colour pictures")
    raise RecordingError(f"{dataset.root}: which pictures? Give --image, one of {_listed(keys)}")


def _steering_by_name(dataset: LeRobotFolder) -> FeatureNumber:
    """The number whose name contains "steer". Numbers of actions, what the driver did, count first."""
    for prefix in ("action", ""):
        named = [
            number
            for number in _all_numbers(dataset)
            if number.feature.startswith(prefix) and "steer" in number.word
        ]
        if len(named) == 1:
            return named[0]
        if named:
            break
    labels = [number.label for number in (named or _all_numbers(dataset))]
    raise RecordingError(
        f"{dataset.root}: which number is the steering? Give --steering, one of {_listed(labels)}"
    )


def _number(dataset: LeRobotFolder, text: str) -> FeatureNumber:
    """The number that --steering names: a feature, and its name or position in it."""
    numbers = _all_numbers(dataset)
    for number in numbers:
        if text in (number.label, f"{number.feature}.{number.index}"):
            return number
    labels = [number.label for number in numbers]
    feature = dataset.features.get(text)
    if feature is not None:
        raise RecordingError(
            f"{dataset.root}: --steering {printable(text)}: not a single number, but {printable(feature.dtype)}"
            f" of shape {feature.shape}; there are {_listed(labels)}"
        )
    hint = did_you_mean(text, labels, " ")
    raise RecordingError(
        f"{dataset.root}: no number {printable(text)!r} for --steering;{hint} it has {_listed(labels)}"
    )


def _all_numbers(dataset: LeRobotFolder) -> list[FeatureNumber]:
    """All numbers of the features that are one number, or one row of numbers."""
    numbers = []
    for name, feature in dataset.features.items():
        if feature.dtype not in _NUMBERS or len(feature.shape) != 1 or not 1 <= feature.shape[0] <= 1000:
            continue
        names = feature.names or ()
        for at in range(feature.shape[0]):
            part = names[at] if len(names) == feature.shape[0] else str(at)
            if feature.shape == (1,):
                numbers.append(FeatureNumber(name, None, f"{name}.{part}" if names else name))
            else:
                numbers.append(FeatureNumber(name, at, f"{name}.{part}"))
    return numbers


def _pedal(dataset: LeRobotFolder, steering: FeatureNumber, words: tuple[str, ...]) -> FeatureNumber | None:
    """The first number of the steering's feature, or of an action, whose name contains one of the words."""
    for prefix in (f"{steering.feature}.", "action"):
        for number in _all_numbers(dataset):
            if number.label.startswith(prefix) and any(word in number.word for word in words):
                return number
    return None


def _speed(dataset: LeRobotFolder) -> FeatureNumber | None:
    for number in _all_numbers(dataset):
        scale = _MPH.get(number.word)
        if scale is not None:
            return replace(number, scale=scale)
    return None


def _listed(names: list[str]) -> str:
    shown = ", ".join(printable(name[:100]) for name in names[:30])
    return f"{shown} and {len(names) - 30} more" if len(names) > 30 else shown or "none"


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
