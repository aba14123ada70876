"""Samples of an index as training sees them, altered, beside the same crops as they were driven."""

from __future__ import annotations

import base64
import dataclasses
from typing import Any, Final

import cv2
import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from common.errors import printable
from common.location import Location, absolute
from common.steering_unit import assumed_deg, steering_unit
from dataset import Samples
from dataset.loader.crops import Crops
from dataset.picture_spec import ORIGINAL
from dataset.preprocessing import Image
from dataset.samples.samples_reader import LOADED
from web.folders.cache_folder import CacheFolder

SHOWN: Final = 12
_COLUMNS: Final = (*LOADED, "row", "camera", "recorded")


class AlteredSample(msgspec.Struct, frozen=True):
    """`pictures`: the crop as it was driven, and what training makes of it, as JPEGs in base64; "" for one that
    does not decode."""

    session: str
    row: int
    camera: str
    done: str  # "mirrored, blur, shadow"
    recorded: str  # with its unit: "3.2°"
    label: str
    pictures: tuple[str, str]

    def jpeg(self, number: int) -> bytes:
        return base64.b64decode(self.pictures[number])


class AlteredSamples(msgspec.Struct, frozen=True):
    """Some of an index's samples, evenly spread among those that are altered."""

    altered: int  # of the training samples
    total: int
    shown: list[AlteredSample]


def altered_samples(index: Location, version: str, others: int, cache: CacheFolder) -> AlteredSamples:
    """`SHOWN` of those of an index of this version; each number `others` shows others. Raises UserError where the
    index or its logs cannot be read."""
    key = f"altered 3 {absolute(index)} {version} {others}"
    return cache.struct(key, AlteredSamples, lambda: _read(index, others))


def _read(index: Location, others: int) -> AlteredSamples:
    with Samples(index) as samples:
        table = samples.of_split("train", _COLUMNS)
        altered = table.filter(pc.or_(pc.not_equal(table["alteration"], ""), table["flip"]))
        # the golden ratio: each round of numbers lies between those of the rounds before
        places = (np.arange(SHOWN) / SHOWN + others * 0.6180339887 / SHOWN) % 1
        chosen = np.unique((places * len(altered)).astype(np.int64)) if len(altered) else np.arange(0)
        return AlteredSamples(len(altered), len(table), _shown(samples, altered.take(pa.array(chosen))))


def _shown(samples: Samples, chosen: pa.Table) -> list[AlteredSample]:
    rows = samples.rows(chosen)
    plain = dataclasses.replace(
        rows, flip=np.zeros(len(rows), np.bool_), alterations=tuple("" for _ in rows.alterations)
    )
    as_driven, as_learnt = (_jpegs(Crops(each, samples.logs, 0), len(rows)) for each in (plain, rows))
    unit = steering_unit(samples.max_steering_deg)
    full = unit.of(assumed_deg(samples.max_steering_deg))
    return [
        AlteredSample(
            printable(sample["session"]),
            sample["row"],
            printable(sample["camera"]),
            ", ".join(["mirrored"] * sample["flip"] + [name for name in sample["alteration"].split("+") if name]),
            # of the unmirrored picture beside it
            f"{sample['recorded'] * (-1 if sample['flip'] else 1) * full:.1f}{unit.sign}",
            f"{sample['label'] * full:.1f}{unit.sign}",
            pictures,
        )
        for sample, pictures in zip(chosen.to_pylist(), zip(as_driven, as_learnt, strict=True), strict=True)
    ]


def _jpegs(crops: Crops, count: int) -> list[str]:
    pictures: Image = np.empty((count, *ORIGINAL.shape), np.uint8)
    failed = crops.fill(pictures, np.arange(count))
    return [_jpeg(picture) if number not in failed else "" for number, picture in enumerate(pictures)]


def _jpeg(picture: Any) -> str:
    ok, encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95])
    return base64.b64encode(encoded.tobytes()).decode() if ok else ""
