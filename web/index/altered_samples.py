"""Samples of an index as a default training sees them in its first epoch, and the crops as recorded."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import cv2
import msgspec
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common.errors import printable
from common.steering_unit import assumed_deg, steering_unit
from common.untrusted import real_path
from dataset import Samples
from dataset.alterations import EpochAlterations
from dataset.loader.crops import Crops
from dataset.picture_spec import ORIGINAL
from dataset.preprocessing import Image
from dataset.samples.samples_reader import LOADED
from model.config import TrainConfig
from web.folders.cache_folder import CacheFolder

SHOWN: Final = 12
_COLUMNS: Final = (*LOADED, "row", "camera", "recorded")


class AlteredSample(msgspec.Struct, frozen=True):
    """`pictures` are the crop as recorded and as trained on, as JPEGs; empty if a picture does not decode."""

    session: str
    row: int
    camera: str
    done: str  # "mirrored, blur, shadow"
    recorded: str  # with its unit: "3.2°"
    label: str
    pictures: tuple[bytes, bytes]


class AlteredSamples(msgspec.Struct, frozen=True):
    """Some training samples of an index, evenly spread."""

    total: int
    shown: list[AlteredSample]


def altered_samples(index: Path, version: str, others: int, cache: CacheFolder) -> AlteredSamples:
    """`SHOWN` training samples of an index of this version; another number `others` gives others. Raises UserError
    if the index or its logs cannot be read."""
    key = f"altered 5 {real_path(index)} {version} {others}"
    return cache.struct(key, AlteredSamples, lambda: _read(index, others))


def _read(index: Path, others: int) -> AlteredSamples:
    with Samples(index) as samples:
        table = samples.of_split("train", _COLUMNS)
        # by the golden ratio, the numbers of each round lie between those of earlier rounds
        places = (np.arange(SHOWN) / SHOWN + others * 0.6180339887 / SHOWN) % 1
        chosen = np.unique((places * len(table)).astype(np.int64)) if len(table) else np.arange(0)
        return AlteredSamples(len(table), _shown(samples, table.take(pa.array(chosen)), chosen))


def _shown(samples: Samples, chosen: pa.Table, numbers: NDArray[np.int64]) -> list[AlteredSample]:
    """The `chosen` samples, which have these numbers in an epoch."""
    rows = samples.rows(chosen)
    plain = dataclasses.replace(
        rows, flip=np.zeros(len(rows), np.bool_), alterations=tuple("" for _ in rows.alterations)
    )
    recipe = TrainConfig()
    epoch = EpochAlterations(recipe.epoch_alterations, recipe.seed, samples.settings.side_correction)
    labels = epoch.labels(rows.label, 1, numbers)
    as_recorded = _jpegs(Crops(plain, samples.logs, 0), len(rows))
    as_learnt = _jpegs(
        Crops(rows, samples.logs, 0), len(rows), lambda pictures, at: epoch.alter(1, pictures, numbers[at])
    )
    unit = steering_unit(samples.max_steering_deg)
    full = unit.of(assumed_deg(samples.max_steering_deg))
    return [
        AlteredSample(
            printable(sample["session"]),
            sample["row"],
            printable(sample["camera"]),
            ", ".join(["mirrored"] * sample["flip"] + [name for name in sample["alteration"].split("+") if name]),
            # of the unmirrored picture next to it
            f"{sample['recorded'] * (-1 if sample['flip'] else 1) * full:.1f}{unit.sign}",
            f"{label * full:.1f}{unit.sign}",
            (before, after),
        )
        for sample, label, before, after in zip(
            chosen.to_pylist(), labels.tolist(), as_recorded, as_learnt, strict=True
        )
    ]


def _jpegs(
    crops: Crops, count: int, altered: Callable[[Image, NDArray[np.int64]], object] | None = None
) -> list[bytes]:
    pictures: Image = np.empty((count, *ORIGINAL.shape), np.uint8)
    failed = crops.fill(pictures, np.arange(count), altered)
    return [_jpeg(picture) if number not in failed else b"" for number, picture in enumerate(pictures)]


def _jpeg(picture: Any) -> bytes:
    # each pixel keeps its own colour: mixed colours would run into each other
    sampling = cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
    ok, encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95, *sampling])
    return encoded.tobytes() if ok else b""
