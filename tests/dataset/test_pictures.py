"""From a log's JPEG to what the network is shown: the crop, the alterations, and the loader's batches."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.car import CAMERAS, Camera
from dataset import Batch, DatasetError, IndexConfig, Loader, Samples, build_index, decode, preprocess
from dataset.augment import alter, blur, brightness, shadow
from dataset.picture_spec import PictureSpec
from dataset.preprocessing import Image
from logs import write_log
from udacity import jpeg

CROP_BYTES = 128 * 128 * 3


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


def test_blur_keeps_the_light_and_spreads_a_column_to_both_sides() -> None:
    picture = np.zeros((128, 128, 3), np.uint8)
    picture[:, 64] = 200
    widths = set()
    for seed in SEEDS:
        row = blur(picture, np.random.default_rng(seed))[64, :, 1].astype(int)
        assert row.sum() == pytest.approx(200, abs=5)  # nine roundings
        assert (row[64 - 10 : 65] == row[64:75][::-1]).all()
        assert row[64] == row.max() < 200
        widths.add(int(np.count_nonzero(row)))
    assert widths <= {3, 5, 7, 9}
    assert len(widths) > 1


def test_brightness_scales_the_value_of_hsv_and_keeps_the_colour() -> None:
    picture = np.empty((128, 128, 3), np.uint8)
    picture[:64], picture[64:] = (40, 80, 120), (15, 60, 30)
    factors = []
    for seed in SEEDS:
        changed = brightness(picture, np.random.default_rng(seed)).astype(float)
        factor = changed[0, 0].max() / 120
        np.testing.assert_allclose(changed, picture * factor, atol=2.5)
        factors.append(factor)
    assert 0.39 < min(factors) < 0.8
    assert 1.2 < max(factors) < 1.61


def test_brightness_does_not_overflow() -> None:
    white = np.full((8, 8, 3), 250, np.uint8)
    for seed in SEEDS:
        assert brightness(white, np.random.default_rng(seed)).min() >= 0.39 * 250


def test_a_shadow_darkens_some_pixels_and_leaves_the_others() -> None:
    picture = np.full((128, 128, 3), 200, np.uint8)
    shares = []
    for seed in SEEDS:
        changed = shadow(picture, np.random.default_rng(seed))
        dark = changed[:, :, 0] != 200
        levels = np.unique(changed[dark])
        assert len(levels) == 1
        assert 0.45 * 200 - 0.5 <= levels[0] <= 0.74 * 200 + 0.5
        assert (changed[~dark] == 200).all()
        assert 0 < dark.mean() < 1
        shares.append(dark.mean())
    assert max(shares) > 0.3


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


def pairs(batches: Iterator[Batch]) -> list[tuple[int, float]]:
    """(brightness of the picture, label) of every sample, in their order."""
    return [
        (round(float(picture.mean())), round(float(label), 4))
        for batch in batches
        for picture, label in zip(batch.pictures, batch.steering, strict=True)
    ]


def expected_pairs(samples: Samples) -> list[tuple[int, float]]:
    shift = {"center": 0.0, "left": 0.2, "right": -0.2}
    return [
        (
            level(row["camera"], row["row"]),
            round((STEERING[row["row"]] + shift[row["camera"]]) * (1 - 2 * flip), 4),
        )
        for row in samples.table.to_pylist()
        for flip in [row["flip"]]
    ]


def test_every_picture_comes_with_its_own_label(samples: Samples) -> None:
    loader = Loader(samples, samples.table, batch=7)
    assert pairs(loader.in_order()) == expected_pairs(samples)


def test_every_sample_comes_once_an_epoch_in_an_order_of_its_own(samples: Samples) -> None:
    loader = Loader(samples, samples.table, batch=7)
    expected = expected_pairs(samples)
    first, second = pairs(loader.epoch(1)), pairs(loader.epoch(2))
    assert first != second
    assert Counter(first) == Counter(second) == Counter(expected)
    assert first == [expected[i] for i in loader.order(1)]


def test_batches_are_full_but_the_last(samples: Samples) -> None:
    sizes = [len(batch.steering) for batch in Loader(samples, samples.table, batch=7).epoch(0)]
    assert sum(sizes) == len(samples.table)
    assert set(sizes[:-1]) == {7}
    assert 0 < sizes[-1] <= 7


def test_the_order_is_a_function_of_seed_and_epoch(samples: Samples) -> None:
    def order(seed: int, epoch: int) -> list[int]:
        found: list[int] = Loader(samples, samples.table, batch=7, seed=seed).order(epoch).tolist()
        return found

    used = Loader(samples, samples.table, batch=7, seed=5)
    list(used.epoch(0))
    assert used.order(3).tolist() == order(5, 3)
    assert len({tuple(order(seed, epoch)) for seed in (0, 5) for epoch in (0, 1, 2)}) == 6
    assert sorted(order(5, 3)) == list(range(len(samples.table)))


@pytest.mark.parametrize("budget_bytes", [0, 1, 5 * CROP_BYTES])
def test_beyond_the_memory_budget_the_batches_are_the_same(samples: Samples, budget_bytes: int) -> None:
    def batches(budget_bytes: int) -> list[tuple[bytes, bytes]]:
        loader = Loader(samples, samples.table, batch=16, budget_bytes=budget_bytes)
        found = [batch for epoch in (0, 1) for batch in loader.epoch(epoch)]
        return [(batch.pictures.tobytes(), batch.steering.tobytes()) for batch in found]

    assert batches(budget_bytes) == batches(1 << 30)


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


def test_the_driving_view_is_the_centre_camera_as_it_is(samples: Samples) -> None:
    seen = samples.driving_view("validation").to_pylist()
    assert {(row["camera"], row["flip"], row["copy"], row["split"]) for row in seen} == {
        ("center", False, False, "validation")
    }
    held_out = {row["row"] for row in samples.of_split("validation").to_pylist()}
    assert sorted(row["row"] for row in seen) == sorted(held_out)


def test_a_log_that_changed_after_it_was_indexed_is_refused(tmp_path: Path) -> None:
    log = write_log(tmp_path / "a.mcap", [0.1, 0.2])
    build_index([log], tmp_path / "index")
    write_log(log, [0.1, 0.3], overwrite=True)
    with pytest.raises(DatasetError, match=r"a\.mcap: has changed.*`bc-index`"):
        Samples(tmp_path / "index")


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
