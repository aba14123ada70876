"""From a log's JPEG to what the network is shown: the crop, and the order of the loader's batches."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from torch import Tensor

from common.car import Camera
from dataset import (
    Batch,
    DatasetError,
    IndexConfig,
    Loader,
    Samples,
    SamplesDataset,
    build_index,
    decode,
    load,
    preprocess,
)
from dataset.picture_spec import ORIGINAL, PictureSpec
from dataset.preprocessing import Image
from model.evaluation.predict import predict
from model.network.pilotnet import SteeringNetwork
from model.training.batches import KeptBatches
from tests.helpers.driving import road_jpeg
from tests.helpers.layouts import write_as_before
from tests.helpers.logs import write_log
from tests.helpers.plain_mcap import contents
from tests.helpers.udacity import encode


def black() -> Image:
    return np.zeros((160, 320, 3), np.uint8)


def bilinear(place: int, source_px: int) -> list[float]:
    """How much of source pixel `place` is in each target pixel: pixel centres lie at halves, ends are repeated."""
    at = [min(max((i + 0.5) * source_px / 128 - 0.5, 0), source_px - 1) for i in range(128)]
    return [max(0.0, 1 - abs(x - place)) for x in at]


# Preprocessing


@pytest.mark.parametrize("row", [50, 51, 90, 138, 139])
def test_a_bright_row_is_where_the_crop_and_the_resize_put_it(row: int) -> None:
    picture = black()
    picture[row] = 255
    crop = preprocess(picture)
    assert crop.shape == (128, 128, 3)
    assert crop.dtype == np.uint8
    expected = 255 * np.array(bilinear(row - 50, source_px=90))
    assert expected.max() > 100
    np.testing.assert_allclose(crop[:, 64, 0], expected, atol=1)
    assert (crop == crop[:, :1]).all()


@pytest.mark.parametrize("column", [1, 160, 161, 318])
def test_a_bright_column_is_where_the_resize_puts_it(column: int) -> None:
    picture = black()
    picture[:, column] = 255
    crop = preprocess(picture)
    np.testing.assert_allclose(crop[64, :, 0], 255 * np.array(bilinear(column, source_px=320)), atol=1)
    assert crop.any()


def test_sky_and_bonnet_are_never_seen() -> None:
    picture = black()
    picture[:50] = picture[140:] = 255
    assert not preprocess(picture).any()


def test_the_order_of_the_channels_is_kept() -> None:
    picture = black()
    picture[:] = (10, 100, 200)
    assert (preprocess(picture) == (10, 100, 200)).all()
    assert (decode(encode(picture, ".png")) == picture).all()


def test_a_larger_picture_shows_the_same_part_of_the_world() -> None:
    picture = np.zeros((320, 640, 3), np.uint8)
    picture[100:280] = 255
    assert (preprocess(picture) == 255).all()
    picture[100:280], picture[:100], picture[280:] = 0, 255, 255
    assert not preprocess(picture).any()


@pytest.mark.parametrize("data", [b"", b"no picture", b"\xff\xd8\xff\xe0 and no more"])
def test_what_is_no_picture_is_a_value_error(data: bytes) -> None:
    with pytest.raises(ValueError, match="picture"):
        decode(data)


def test_a_header_that_promises_too_many_pixels_is_no_picture() -> None:
    data = bytearray(encode(np.zeros((16, 16, 3), np.uint8)))
    size = data.index(b"\xff\xc0") + 5  # of the frame header: height and width, two bytes each
    data[size : size + 4] = (65500).to_bytes(2, "big") * 2
    with pytest.raises(ValueError, match="more than 67,108,864 pixels"):
        decode(bytes(data))
    longer = bytearray(encode(np.zeros((1, 16), np.uint8), ".png"))
    longer[16:20] = (1 << 21).to_bytes(4, "big")  # few pixels, but more columns than OpenCV allows
    with pytest.raises(ValueError, match="not a picture"):
        decode(bytes(longer))


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
        {"resize": "nearest"},
        {"crop_top": "50/120"},
        {"crop_top": "150/160"},
        {"width_px": "99999999"},
        {"width_px": 128},
        {"more": "1"},
    ],
)
def test_what_no_training_writes_is_refused(changed: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        PictureSpec.from_description({**ORIGINAL.description, **changed})


STEERING = [round(-0.6 + 0.05 * row, 2) for row in range(24)]
BROKEN: dict[tuple[Camera, int], bytes] = {
    ("left", 2): b"this is no picture",
    ("center", 5): b"",
    ("center", 11): b"\xff\xd8\xff\xe0 cut off",
}
NAMES = {f"lake row {row} {camera}" for camera, row in BROKEN}


def shade(camera: Camera, row: int) -> int:
    """Which grey the picture of a camera and row has: far enough apart to survive JPEG."""
    return 20 + 3 * (3 * row + ["left", "center", "right"].index(camera))


def picture(camera: Camera, row: int) -> bytes:
    if (camera, row) in BROKEN:
        return BROKEN[camera, row]
    return encode(np.full((160, 320, 3), shade(camera, row), np.uint8))


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drives")
    log = write_log(folder / "lake.mcap", STEERING, picture)
    config = IndexConfig(validation_share=0.0, balance=False)
    return build_index([log], folder / "index", config).path


def expected(index: Path) -> list[tuple[int, float]]:
    """Shade and label of every sample whose picture is whole, in the order of the index."""
    rows = pq.read_table(index / "samples.parquet").to_pylist()
    assert {(row["camera"], row["row"]) for row in rows} > BROKEN.keys()
    return [
        (shade(row["camera"], row["row"]), float(np.float32(row["label"])))
        for row in rows
        if (row["camera"], row["row"]) not in BROKEN
    ]


def seen(pictures: np.ndarray | Tensor, steering: np.ndarray | Tensor) -> list[tuple[int, float]]:
    levels = np.asarray(pictures).reshape(len(pictures), -1).mean(axis=1).round().astype(int).tolist()
    return list(zip(levels, np.asarray(steering).tolist(), strict=True))


def seen_in(batches: Sequence[Batch]) -> list[tuple[int, float]]:
    return [sample for batch in batches for sample in seen(batch.pictures, batch.steering)]


@pytest.mark.parametrize("budget_bytes", [0, 1 << 30])
def test_an_undecodable_picture_leaves_its_batches_and_is_named_once(index: Path, budget_bytes: int) -> None:
    with load(index, batch=16, budget_bytes=budget_bytes) as loader:
        assert len(loader.skipped) == 0
        for epoch in (1, 2):
            batches = list(loader.epoch(epoch))
            assert len(batches) == loader.batches
            assert min(len(batch.steering) for batch in batches[:-1]) < 16
            assert sorted(seen_in(batches)) == sorted(expected(index))
        assert sum(len(batch.steering) for batch in batches) < len(loader)
        assert [reason for reason, _ in loader.skipped] == ["pictures that do not decode"] * len(BROKEN)
        assert {name for _, name in loader.skipped} == NAMES


def test_predictions_stay_beside_what_was_recorded(index: Path) -> None:
    with load(index, batch=16) as loader:
        assert seen_in(list(loader.in_order())) == expected(index)
        assert len(loader.skipped) == len(BROKEN)
    with load(index, batch=16, driving_view=True) as loader:
        predicted, recorded = predict(SteeringNetwork(), loader)
        assert {name for _, name in loader.skipped} == {"lake row 5 center", "lake row 11 center"}
    assert len(predicted) == len(recorded) == len(STEERING) - 2
    assert recorded.tolist() == [np.float32(value) for row, value in enumerate(STEERING) if row not in (5, 11)]


def test_crops_on_the_device_are_without_them_too(index: Path) -> None:
    with load(index, batch=16) as host, load(index, batch=16) as other:
        device = KeptBatches(other, torch.device("cpu"))
        assert {name for _, name in other.skipped} == NAMES  # all are read before the first epoch
        for epoch in (1, 2):
            for batch, (pictures, steering) in zip(host.epoch(epoch), device.epoch(epoch), strict=True):
                assert seen(pictures, steering) == seen_in([batch])
        assert len(other.skipped) == len(BROKEN)


@pytest.mark.parametrize("layout", ["two kinds of chunks", "of an earlier version"])
def test_pictures_of_a_damaged_chunk_are_left_out_and_named_and_no_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, layout: str
) -> None:
    monkeypatch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", 20_000)
    log = write_log(tmp_path / "lake.mcap", STEERING, picture)
    if layout == "of an earlier version":
        write_as_before(log, tmp_path / "before.mcap", 20_000).replace(log)
    build_index([log], tmp_path / "index", IndexConfig(validation_share=0.0, balance=False))
    place = log.read_bytes().index(b"this is no picture")
    chunk = next(chunk for chunk in contents(log).chunks if chunk.start < place < chunk.end)
    lost = {
        (message.topic.rpartition("/")[2], message.sequence)
        for message in chunk.messages
        if "camera" in message.topic
    }
    assert 3 < len(lost) < 30
    with log.open("rb+") as stream:
        stream.seek(place)
        stream.write(b"THIS")
    rows = pq.read_table(tmp_path / "index" / "samples.parquet").to_pylist()
    expected = [
        (shade(row["camera"], row["row"]), float(np.float32(row["label"])))
        for row in rows
        if (row["camera"], row["row"]) not in BROKEN and (row["camera"], row["row"]) not in lost
    ]
    with load(tmp_path / "index", batch=16) as loader:
        for epoch in (1, 2):
            assert sorted(seen_in(list(loader.epoch(epoch)))) == sorted(expected)
        in_damage = [name for kind, name in loader.skipped if kind.startswith("pictures in damaged chunks of ")]
        assert len(in_damage) == len(lost)
        if layout == "two kinds of chunks":  # the rows of the other layout are among what is damaged
            assert set(in_damage) == {f"lake row {row} {camera}" for camera, row in lost}
    at = next(number for number, row in enumerate(rows) if (row["camera"], row["row"]) == ("left", 2))
    dataset = SamplesDataset(tmp_path / "index")
    with pytest.raises(DatasetError, match=r"lake\.mcap: damaged.*`bc-log recover"):
        dataset[at]
    dataset.close()
