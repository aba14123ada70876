"""Finds steering, pedals, speed and cameras among a LeRobot dataset's features, by flags or names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from common.car import CAMERAS, MPS_PER_MPH, Camera
from common.errors import did_you_mean, printable
from recorder.errors import RecordingError
from recorder.lerobot.dataset_format import ACTION_NAMES, LOG_TIME, LOG_VEHICLE, Feature, image_key
from recorder.sources.lerobot_dataset import LeRobotFolder
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
