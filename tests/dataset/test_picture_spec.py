"""What a network sees belongs to its run: size, crop and order of the colours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from dataset import IndexConfig, Loader, Samples, build_index, decode, preprocess
from dataset.picture_spec import ORIGINAL, PictureSpec
from tests.helpers.driving import road_jpeg
from tests.helpers.logs import write_log

WIDE = PictureSpec(width_px=200, height_px=66, crop_top=60, crop_bottom=10, channels="YUV")


def by_hand(picture: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    return cv2.cvtColor(cv2.resize(picture[60:150], (200, 66)), cv2.COLOR_BGR2YUV)


def test_a_picture_is_cropped_resized_and_brought_into_its_colours() -> None:
    picture = decode(road_jpeg(7))
    assert (preprocess(picture, WIDE) == by_hand(picture)).all()
    assert (preprocess(picture) == cv2.resize(picture[50:140], (128, 128))).all()
    assert (preprocess(picture, PictureSpec(channels="RGB")) == preprocess(picture)[:, :, ::-1]).all()


def test_the_loader_alters_a_networks_view_before_its_colours(tmp_path: Path) -> None:
    log = write_log(tmp_path / "log.mcap", [0.1, -0.2, 0.5] * 4, lambda _, row: road_jpeg(row), cameras=["center"])
    index = build_index([log], tmp_path / "index", IndexConfig(validation_share=0, max_uses=3)).path
    with Samples(index) as samples:
        plain, seen = (
            np.concatenate(
                [batch.pictures for batch in Loader(samples, samples.table, batch=9, seen=spec).in_order()]
            )
            for spec in (PictureSpec(200, 66, 60, 10), WIDE)
        )
        pictures = samples.table["row"].to_numpy()
        is_original = ~samples.table["copy"].to_numpy() & ~samples.table["flip"].to_numpy()
    assert not is_original.all()
    for bgr, yuv, row, is_plain in zip(plain, seen, pictures, is_original, strict=True):
        assert (cv2.cvtColor(bgr, cv2.COLOR_BGR2YUV) == yuv).all()
        if is_plain:
            assert (yuv == by_hand(decode(road_jpeg(row)))).all()


@pytest.mark.parametrize(
    "changed",
    [
        {"channels": "HSV"},
        {"channels": ["BGR"]},
        {"resize": "nearest"},
        {"crop_top": "50/120"},
        {"crop_top": "150/160"},
        {"crop_bottom": "-1/160"},
        {"width_px": "99999999"},
        {"width_px": "0"},
        {"width_px": 128},
        {"height_px": "٣٢"},
        {"more": "1"},
    ],
)
def test_what_no_training_writes_is_refused(changed: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        PictureSpec.from_description({**ORIGINAL.description, **changed})
