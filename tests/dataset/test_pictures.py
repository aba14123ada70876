"""From a log's JPEG to what the network is shown: the crop, the alterations, and the loader's batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.car import CAMERAS, Camera
from dataset import IndexConfig, Loader, Samples, build_index, decode, preprocess
from dataset.augment import alter, blur, brightness, shadow
from dataset.picture_spec import PictureSpec
from dataset.preprocessing import Image
from logs import write_log
from udacity import jpeg


def black() -> Image:
    return np.zeros((160, 320, 3), np.uint8)


def bilinear(place: int, source_px: int, target_px: int = 128) -> list[float]:
    """How much of source pixel `place` is in each target pixel: pixel centres lie at halves, ends are repeated."""
    at = [min(max((i + 0.5) * source_px / target_px - 0.5, 0), source_px - 1) for i in range(target_px)]
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


@pytest.mark.parametrize("rows", [slice(0, 50), slice(140, 160)])
def test_sky_and_bonnet_are_never_seen(rows: slice) -> None:
    picture = black()
    picture[rows] = 255
    assert not preprocess(picture).any()


def test_the_order_of_the_channels_is_kept() -> None:
    picture = black()
    picture[:] = (10, 100, 200)
    assert (preprocess(picture) == (10, 100, 200)).all()
    ok, encoded = cv2.imencode(".png", picture)
    assert ok
    assert (decode(encoded.tobytes()) == picture).all()


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


# Alterations


SEEDS = range(20)


def noise(seed: int = 0) -> Image:
    return np.random.default_rng(seed).integers(0, 256, (128, 128, 3), dtype=np.uint8)


Change = Callable[[Image, np.random.Generator], Image]


@pytest.mark.parametrize("change", [blur, brightness, shadow])
def test_an_alteration_is_pure(change: Change) -> None:
    picture = noise()
    before = picture.copy()
    picture.flags.writeable = False
    one, two = (change(picture, np.random.default_rng(3)) for _ in range(2))
    assert (one == two).all()
    assert (picture == before).all()
    assert one.shape == picture.shape
    assert one.dtype == np.uint8
    results = {change(picture, np.random.default_rng(seed)).tobytes() for seed in SEEDS}
    assert len(results) > 2
    assert before.tobytes() not in results


def test_alterations_follow_one_another_and_none_is_none() -> None:
    picture = noise()
    assert (alter(picture, "", 7) == picture).all()
    random = np.random.default_rng(7)
    assert (alter(picture, "blur+shadow", 7) == shadow(blur(picture, random), random)).all()


# The loader

STEERING = [round(-0.6 + 0.05 * row, 2) for row in range(24)]


def level(camera: Camera, row: int) -> int:
    return 20 + 3 * (3 * row + CAMERAS.index(camera))


def grey(camera: Camera, row: int) -> bytes:
    """A picture whose brightness says which row and camera it is of."""
    return jpeg(level(camera, row))


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("index")
    log = write_log(folder / "a.mcap", STEERING, grey)
    return build_index([log], folder / "index", IndexConfig(block_s=0.5, gap_s=0, alter=())).path


@pytest.fixture
def samples(index: Path) -> Iterator[Samples]:
    opened = Samples(index)
    yield opened
    opened.close()


def test_the_order_is_a_function_of_seed_and_epoch(samples: Samples) -> None:
    def order(seed: int, epoch: int) -> list[int]:
        found: list[int] = Loader(samples, samples.table, batch=7, seed=seed).order(epoch).tolist()
        return found

    used = Loader(samples, samples.table, batch=7, seed=5)
    list(used.epoch(0))
    assert used.order(3).tolist() == order(5, 3)
    assert len({tuple(order(seed, epoch)) for seed in (0, 5) for epoch in (0, 1, 2)}) == 6
    assert sorted(order(5, 3)) == list(range(len(samples.table)))


def half_bright(camera: Camera, row: int) -> bytes:
    picture = black()
    picture[:, :160] = 200
    ok, encoded = cv2.imencode(".jpg", picture)
    assert ok
    return encoded.tobytes()


def test_a_flipped_sample_is_the_mirror_image_of_its_original(tmp_path: Path) -> None:
    log = write_log(tmp_path / "a.mcap", [0.3], half_bright, cameras=["center"])
    build_index([log], tmp_path / "index")
    samples = Samples(tmp_path / "index")
    try:
        [batch] = Loader(samples, samples.table, batch=4).in_order()
        flips = samples.table["flip"].to_pylist()
        assert sorted(flips) == [False, True]
        straight, mirrored = (batch.pictures[flips.index(flip)] for flip in (False, True))
        assert (straight[:, :60].min(), straight[:, 68:].max()) > (150, 0)
        assert straight[:, 68:].max() < 50
        assert (mirrored == straight[:, ::-1]).all()
        assert [round(float(batch.steering[flips.index(flip)]), 4) for flip in (False, True)] == [0.3, -0.3]
    finally:
        samples.close()


def test_a_copy_is_altered_as_the_index_says(tmp_path: Path) -> None:
    log = write_log(tmp_path / "a.mcap", [0.0] * 20 + [0.5], half_bright, cameras=["center"])
    build_index([log], tmp_path / "index", IndexConfig(validation_share=0.0))
    samples = Samples(tmp_path / "index")
    try:
        rows = samples.table.to_pylist()
        assert sum(row["alteration"] != "" for row in rows) > 3
        crop = preprocess(decode(half_bright("center", 0)))
        pictures = [
            picture for batch in Loader(samples, samples.table, batch=8).in_order() for picture in batch.pictures
        ]
        for row, picture in zip(rows, pictures, strict=True):
            seen = np.ascontiguousarray(crop[:, ::-1]) if row["flip"] else crop
            assert (picture == alter(seen, row["alteration"], row["seed"])).all()
    finally:
        samples.close()


def test_a_header_that_promises_too_many_pixels_is_no_picture() -> None:
    ok, encoded = cv2.imencode(".jpg", np.zeros((16, 16, 3), np.uint8))
    assert ok
    data = bytearray(encoded.tobytes())
    size = data.index(b"\xff\xc0") + 5  # of the frame header: height and width, two bytes each
    data[size : size + 4] = (65500).to_bytes(2, "big") * 2
    with pytest.raises(ValueError, match="more than 67,108,864 pixels"):
        decode(bytes(data))
    ok, line = cv2.imencode(".png", np.zeros((1, 16), np.uint8))
    assert ok
    longer = bytearray(line.tobytes())
    longer[16:20] = (1 << 21).to_bytes(4, "big")  # few pixels, but more columns than OpenCV allows
    with pytest.raises(ValueError, match="not a picture"):
        decode(bytes(longer))


@pytest.mark.parametrize("height", range(1, 9))
@pytest.mark.parametrize(("top", "bottom"), [(50, 20), (159, 0), (0, 159)])
def test_a_crop_leaves_a_row_of_any_picture(height: int, top: int, bottom: int) -> None:
    spec = PictureSpec(crop_top=top, crop_bottom=bottom)
    assert preprocess(np.zeros((height, 320, 3), np.uint8), spec).shape == spec.shape
