"""What an alteration does to the pixels, known from pictures whose result can be worked out by hand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from dataset import DatasetError
from dataset.alterations import alter, blur, brightness, shadow
from dataset.preprocessing import Image

Change = Callable[[Image, np.random.Generator], Image]

SEEDS = range(200)
# Rounding to 8 bits: what a factor gives may be off by one half; HSV keeps hue in steps of 2 degrees.
ROUNDING, HSV_ROUNDING = 0.5, 3.0


def drawn(change: Change, picture: Image, seed: int) -> Image:
    return change(picture, np.random.default_rng(seed))


def grey(level: int, height: int = 64, width: int = 64) -> Image:
    return np.full((height, width, 3), level, np.uint8)


def ramp() -> Image:
    """Every grey level once, from left to right, 40 rows of it."""
    return np.tile(np.arange(256, dtype=np.uint8)[None, :, None], (40, 1, 3))


# Blur


def bright_column() -> Image:
    picture = grey(0, 41, 41)
    picture[:, 20] = 255
    return picture


def blur_width(seed: int) -> int:
    """In how many columns one bright column ends up: the size of the kernel."""
    return int(np.count_nonzero(drawn(blur, bright_column(), seed)[20, :, 0]))


def test_blur_draws_each_odd_kernel_from_3_to_9_about_as_often() -> None:
    widths = Counter(blur_width(seed) for seed in SEEDS)
    assert widths.keys() == {3, 5, 7, 9}
    assert min(widths.values()) > len(SEEDS) / 8


@pytest.mark.parametrize("kernel", [3, 5, 7, 9])
def test_blur_is_gaussian_and_the_same_in_both_directions(kernel: int) -> None:
    seed = next(seed for seed in SEEDS if blur_width(seed) == kernel)
    profile = drawn(blur, bright_column(), seed)[20, :, 0].astype(float)
    # the sigma that OpenCV documents for a kernel of this size
    sigma = 0.3 * ((kernel - 1) * 0.5 - 1) + 0.8
    distance = np.abs(np.arange(41) - 20)
    gaussian = np.where(distance <= kernel // 2, np.exp(-(distance**2) / (2 * sigma**2)), 0)
    np.testing.assert_allclose(profile, 255 * gaussian / gaussian.sum(), atol=0.04 * 255)
    point = grey(0, 41, 41)
    point[20, 20] = 255
    spot = drawn(blur, point, seed)[:, :, 1].astype(float)
    np.testing.assert_allclose(spot, np.outer(profile, profile) / 255, atol=1)


# Brightness


def brightness_factor(seed: int) -> float:
    """From a grey of 150, which no factor up to 1.7 takes beyond 255."""
    return float(drawn(brightness, grey(150, 1, 1), seed)[0, 0, 0]) / 150


def test_brightness_draws_factors_evenly_from_0_4_to_1_6() -> None:
    factors = np.array([brightness_factor(seed) for seed in SEEDS])
    assert factors.min() >= 0.4 - ROUNDING / 150
    assert factors.max() <= 1.6 + ROUNDING / 150
    assert 0.4 * len(SEEDS) < np.count_nonzero(factors < 1) < 0.6 * len(SEEDS)
    counts, _ = np.histogram(factors, bins=6, range=(0.395, 1.605))
    assert counts.min() > len(SEEDS) / 12


def test_brightness_multiplies_every_grey_level_and_ends_at_white() -> None:
    for seed in range(40):
        factor = brightness_factor(seed)
        expected = np.minimum(ramp() * factor, 255)
        # the factor itself is known to half a level in 150
        np.testing.assert_allclose(drawn(brightness, ramp(), seed), expected, atol=2 * ROUNDING + 255 / 300)


def test_brightness_keeps_hue_and_saturation_where_a_channel_overflows() -> None:
    """HSV's value is the largest channel: with it, the two others are scaled by the same factor."""
    for colour in ((200, 120, 60), (10, 90, 160), (30, 160, 30), (240, 240, 20), (255, 128, 0)):
        picture = np.full((4, 4, 3), colour, np.uint8)
        for seed in range(40):
            factor = min(brightness_factor(seed), 255 / max(colour))
            expected = np.array(colour) * factor
            changed = drawn(brightness, picture, seed)
            np.testing.assert_allclose(changed, np.broadcast_to(expected, changed.shape), atol=HSV_ROUNDING)


# Shadow


@pytest.fixture
def polygons(monkeypatch: pytest.MonkeyPatch) -> list[NDArray[np.int32]]:
    """The corners (N, 2) of every polygon that is filled from now on; OpenCV fills them as ever."""
    seen: list[NDArray[np.int32]] = []
    fill = cv2.fillPoly

    def watched(mask: Image, corners: list[NDArray[np.int32]], level: int) -> None:
        seen.extend(corners)
        fill(mask, corners, level)

    monkeypatch.setattr(cv2, "fillPoly", watched)
    return seen


def test_a_shadow_is_one_to_five_polygons_of_three_to_six_corners(polygons: list[NDArray[np.int32]]) -> None:
    counts, corners = Counter[int](), Counter[int]()
    for seed in SEEDS:
        polygons.clear()
        drawn(shadow, grey(200, 40, 90), seed)
        counts[len(polygons)] += 1
        corners.update(len(polygon) for polygon in polygons)
        for polygon in polygons:
            assert (polygon >= 0).all()
            assert (polygon < (90, 40)).all()  # x, y
    assert counts.keys() == {1, 2, 3, 4, 5}
    assert min(counts.values()) > len(SEEDS) / 10
    assert corners.keys() == {3, 4, 5, 6}


def test_a_shadow_keeps_0_45_to_0_74_of_the_light() -> None:
    factors = np.array([drawn(shadow, grey(200), seed).min() / 200 for seed in SEEDS])
    assert factors.min() >= 0.45 - ROUNDING / 200
    assert factors.max() <= 0.74 + ROUNDING / 200
    counts, _ = np.histogram(factors, bins=5, range=(0.4475, 0.7425))
    assert counts.min() > len(SEEDS) / 10


# All of them


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ("blur", (123.2, 120, 150)),
        ("brightness", (142.8, 140, 255)),
        ("shadow", (93.3, 67, 250)),
        ("blur+brightness+shadow", (74.2, 55, 109)),
        ("blur+shadow+brightness", (117.2, 88, 171)),
        ("brightness+blur+shadow", (127.9, 98, 172)),
        ("brightness+shadow+blur", (108.0, 70, 198)),
        ("shadow+blur+brightness", (147.0, 106, 255)),
        ("shadow+brightness+blur", (148.1, 107, 204)),
    ],
)
def test_an_index_means_the_same_pictures_as_ever(names: str, expected: tuple[float, int, int]) -> None:
    """Mean, least and most level, noted when the first index was built: another order of draws changes them."""
    picture = grey(120, 41, 41)
    picture[:, 20] = 250
    altered = alter(picture, names, 0)
    assert (altered.mean(), altered.min(), altered.max()) == pytest.approx(expected, abs=1)


@pytest.mark.parametrize("names", ["blur", "brightness", "shadow", "blur+brightness", "blur+brightness+shadow"])
def test_the_same_seed_gives_the_same_picture_another_seed_another(names: str) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    picture.flags.writeable = False
    results = [alter(picture, names, seed).tobytes() for seed in range(20)]
    assert results == [alter(picture, names, seed).tobytes() for seed in range(20)]
    assert len(set(results)) >= 4  # there are but four blurs
    assert picture.tobytes() not in results


@pytest.mark.parametrize(
    ("names", "seed"),
    [("rain", 1), ("blur+rain", 1), ("blur+", 1), ("blur", -1), ("blur,shadow", 1), ("blur+blur", 1)],
)
def test_what_no_index_of_ours_asks_for_is_an_error_with_what_to_do(names: str, seed: int) -> None:
    with pytest.raises(DatasetError, match=r"is not an alteration; build the index again with `bc-index`"):
        alter(grey(100), names, seed)
