"""Alterations of every picture in every epoch: what they do, and that seed, epoch and sample alone decide."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dataset import IndexConfig, Loader, build_index, load
from dataset.alterations import EpochAlterations
from dataset.config import EPOCH_ALTERATIONS, EpochAlteration
from dataset.picture_spec import PictureSpec
from dataset.preprocessing import Image, in_channels
from tests.helpers.logs import write_log
from tests.helpers.udacity import scene

STEERING = [round(-0.6 + 0.1 * row, 2) for row in range(12)]
COUNT = 300
SAMPLES = np.arange(COUNT)
HEIGHT, WIDTH = 64, 128


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drives")
    log = write_log(folder / "lake.mcap", STEERING, scene)
    config = IndexConfig(block_s=0.3, gap_s=0, per_bin=6, side_correction=0.1)
    return build_index([log], folder / "index", config).path


def alterations_of(*names: EpochAlteration, seed: int = 0, side_correction: float = 0.2) -> EpochAlterations:
    return EpochAlterations(names, seed, side_correction)


def altered(picture: Image, *names: EpochAlteration, epoch: int = 1) -> Image:
    """The picture as each of the samples shows it (COUNT, height, width, 3)."""
    pictures = np.repeat(picture[None], COUNT, axis=0)
    alterations_of(*names).alter(epoch, pictures, SAMPLES)
    return pictures


def grey(level: int) -> Image:
    return np.full((HEIGHT, WIDTH, 3), level, np.uint8)


def spot(x: float = WIDTH / 2, y: float = HEIGHT / 2) -> Image:
    """A soft white spot on black."""
    columns, rows = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    light = 255 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 18)
    return np.repeat(light.round()[:, :, None], 3, axis=2).astype(np.uint8)


def places(pictures: Image) -> NDArray[np.float64]:
    """(N, 2), px: the column and the row of the light's middle."""
    light = pictures[:, :, :, 0].astype(float)
    total = light.sum(axis=(1, 2))
    columns = (light.sum(axis=1) * np.arange(WIDTH)).sum(axis=1) / total
    rows = (light.sum(axis=2) * np.arange(HEIGHT)).sum(axis=1) / total
    return np.stack([columns, rows], axis=1)


# Seed, epoch, sample


def batches(loader: Loader, epoch: int, start: int = 0) -> list[tuple[bytes, list[float]]]:
    return [(batch.pictures.tobytes(), batch.labels.tolist()) for batch in loader.epoch(epoch, start)]


def by_sample(index: Path, epoch: int = 1, **settings: Any) -> dict[int, tuple[bytes, float]]:
    """What each sample shows in an epoch."""
    with load(index, alter_each_epoch=EPOCH_ALTERATIONS, **settings) as loader:
        shown = {}
        for part, batch in zip(loader.parts(epoch), loader.epoch(epoch), strict=True):
            for sample, picture, steering in zip(part, batch.pictures, batch.steering, strict=True):
                shown[int(sample)] = picture.tobytes(), float(steering)
        return shown


def test_threads_batches_and_memory_do_not_matter(index: Path) -> None:
    expected = by_sample(index, batch=8, threads=1)
    assert by_sample(index, batch=50, threads=4, budget_bytes=0) == expected


def test_another_epoch_or_seed_changes_every_sample(index: Path) -> None:
    first = by_sample(index)
    for other in (by_sample(index, epoch=2), by_sample(index, seed=1)):
        assert other.keys() == first.keys()
        assert all(other[sample][0] != first[sample][0] for sample in first)
        assert sum(other[sample][1] != first[sample][1] for sample in first) > 0.9 * len(first)
    # a mirror image, and a copy, of a picture are other samples
    assert len({picture for picture, _ in first.values()}) == len(first)


def test_an_alteration_is_drawn_the_same_whichever_others_there_are() -> None:
    assert (altered(spot(), "move", "box", "noise") != altered(spot(), "move")).any()
    alone, together = (
        alterations_of("move").draw(2, SAMPLES, 64, 64),
        alterations_of("noise", "move", "shadow").draw(2, SAMPLES, 64, 64),
    )
    assert alone.matrix is not None
    assert together.matrix is not None
    assert (alone.matrix == together.matrix).all()


def test_mixed_colours_change_no_draw_of_version_0_3() -> None:
    names = [name for name in EPOCH_ALTERATIONS if name != "mix"]
    earlier, today = (alterations_of(*some).draw(3, SAMPLES, 64, 64) for some in (names, EPOCH_ALTERATIONS))
    for name in ("matrix", "shade", "strip", "box", "noise", "piece"):
        assert (np.asarray(getattr(earlier, name)) == np.asarray(getattr(today, name))).all()


# Nothing else is altered


def test_elsewhere_pictures_and_labels_are_those_of_the_index(index: Path) -> None:
    with load(index, batch=16) as plain, load(index, batch=16, alter_each_epoch=EPOCH_ALTERATIONS) as loader:
        assert batches(plain, 1) != batches(loader, 1)
        order = loader.order(1)
        [(_, crops), *_] = loader.crops(order[:16])
        first = next(plain.epoch(1))
        assert (crops == first.pictures).all()
        assert (loader.pictures_of(order[:16]) == first.pictures).all()
        assert (first.steering == loader.rows.label[order[:16]]).all()
        for left, right in zip(plain.in_order(), loader.in_order(), strict=True):
            assert (left.pictures == right.pictures).all()
            assert (left.labels == right.labels).all()


@pytest.mark.parametrize("spec", [PictureSpec(), PictureSpec(200, 66, 60, 25, "YUV"), PictureSpec(96, 48)])
def test_own_pictures_are_altered_before_their_colours_change(index: Path, spec: PictureSpec) -> None:
    bgr = PictureSpec(spec.width_px, spec.height_px, spec.crop_top, spec.crop_bottom)
    with load(index, seen=bgr) as plain, load(index, seen=spec, alter_each_epoch=EPOCH_ALTERATIONS) as loader:
        order = plain.order(5)
        pictures = np.concatenate([batch.pictures for batch in plain.epoch(5)])
        alterations_of(*EPOCH_ALTERATIONS).alter(5, pictures, order)
        expected = [in_channels(picture, spec) for picture in pictures]
        assert (np.concatenate([batch.pictures for batch in loader.epoch(5)]) == expected).all()


# The label moves with the picture


def test_a_move_is_up_to_8_columns_each_0_0075_of_steering() -> None:
    moved = places(altered(spot(), "move")) - places(spot()[None])
    assert -8 <= moved[:, 0].min() < -7
    assert 7 < moved[:, 0].max() <= 8
    assert np.abs(moved[:, 1]).max() == pytest.approx(5 * HEIGHT / 128, abs=0.2)
    labels = alterations_of("move").labels(np.full(COUNT, 0.1, np.float32), 1, SAMPLES)
    np.testing.assert_allclose(labels - 0.1, 0.0075 * moved[:, 0], atol=0.0075 * 0.1)


def test_another_size_moves_by_its_share_steering_by_side_correction() -> None:
    narrow = alterations_of("move").draw(1, SAMPLES, 32, 64).matrix
    wide = alterations_of("move").draw(1, SAMPLES, 64, 128).matrix
    assert narrow is not None
    assert wide is not None
    np.testing.assert_allclose(2 * narrow[:, :, 2], wide[:, :, 2])
    none = np.zeros(COUNT, np.float32)
    of_side = {size: alterations_of("move", side_correction=size).labels(none, 1, SAMPLES) for size in (0.1, 0.2)}
    np.testing.assert_allclose(2 * of_side[0.1], of_side[0.2], rtol=1e-5)


def test_of_several_targets_only_steering_moves_up_to_full_lock() -> None:
    before = np.stack([np.linspace(-1, 1, COUNT), np.full(COUNT, np.nan)], axis=1).astype(np.float32)
    labels = alterations_of("move").labels(before, 1, SAMPLES)
    assert np.isnan(labels[:, 1]).all()
    assert np.abs(labels[:, 0]).max() == 1
    assert (labels[:, 0] != before[:, 0]).mean() > 0.9
    assert before[0, 0] == -1  # the index's own are not touched


# What each does


def test_zoom_keeps_the_middle_and_moves_the_rest_by_a_tenth() -> None:
    middle = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
    assert np.abs(places(altered(spot(*middle), "zoom")) - middle).max() < 0.1
    share = (places(altered(spot(middle[0] + 40, middle[1]), "zoom"))[:, 0] - middle[0]) / 40
    assert share.min() == pytest.approx(0.9, abs=0.02)
    assert share.max() == pytest.approx(1.1, abs=0.02)


def test_contrast_keeps_the_middle_brightness_adds_colours_are_apart() -> None:
    dark, bright = altered(grey(78), "contrast")[:, 0, 0], altered(grey(178), "contrast")[:, 0, 0]
    factor = (bright.astype(float) - dark) / 100
    assert (factor.min(), factor.max()) == pytest.approx((0.7, 1.3), abs=0.02)
    np.testing.assert_allclose(dark, 127.5 - 49.5 * factor, atol=1)
    level = altered(grey(100), "brightness")[:, 0, 0].astype(float)
    assert (level.min(), level.max()) == pytest.approx((70, 130), abs=1)
    assert (level == level[:, :1]).all()
    colours = altered(grey(100), "colours")[:, 0, 0].astype(float)
    assert (colours.min(), colours.max()) == pytest.approx((85, 115), abs=1)
    assert np.abs(np.corrcoef(colours.T) - np.eye(3)).max() < 0.2


def test_half_of_the_pictures_have_mixed_colours_around_middle_grey() -> None:
    assert np.abs(altered(grey(128), "mix").astype(int) - 128).max() <= 1
    lighter = altered(grey(148), "mix")[:, 0, 0].astype(int) - 128
    is_mixed = (np.abs(lighter - 20) > 1).any(axis=1)
    assert 0.4 * COUNT < is_mixed.sum() < 0.6 * COUNT
    assert 0.1 < (lighter[is_mixed] < 0).mean() < 0.4  # negatives
    red = grey(128)
    red[:, :, 2] = 168
    blue = altered(red, "mix")[:, 0, 0, 0].astype(int) - 128
    assert (np.abs(blue[is_mixed]) > 1).mean() > 0.7
    assert (blue[~is_mixed] == 0).mean() > 0.9


def test_half_of_the_pictures_have_a_shadow_from_edge_to_edge() -> None:
    pictures = altered(grey(200), "shadow")[:, :, :, 0]
    shadowed = [picture for picture in pictures if (picture < 200).any()]
    assert 0.4 * COUNT < len(shadowed) < 0.6 * COUNT
    assert all(len(np.unique(picture)) <= 2 for picture in shadowed)
    assert min(picture.min() for picture in shadowed) == pytest.approx(90, abs=3)
    assert max(picture.min() for picture in shadowed) == pytest.approx(150, abs=3)
    edges = np.abs(np.diff((np.array(shadowed) < 200).astype(int), axis=2)).sum(axis=2)
    assert (edges <= 2).mean() > 0.99  # one strip; OpenCV leaves a pixel out where a steep edge leaves the picture


def test_a_third_of_the_pictures_have_a_box_of_one_level() -> None:
    pictures = altered(spot(), "box")
    boxes = [np.argwhere((picture != spot()).any(axis=2)) for picture in pictures]
    boxes = [box for box in boxes if len(box)]
    assert 0.25 * COUNT < len(boxes) < 0.42 * COUNT
    for box in boxes:
        height, width = np.ptp(box, axis=0) + 1
        assert height <= 0.4 * HEIGHT + 1
        assert width <= 0.4 * WIDTH + 1


def test_noise_is_drawn_up_to_a_standard_deviation_of_8_without_a_shift() -> None:
    pictures = altered(grey(128), "noise").astype(float)
    deviation = pictures.std(axis=(1, 2, 3))
    assert deviation.min() < 0.5
    assert deviation.max() == pytest.approx(8, abs=0.5)
    assert np.abs(pictures.mean(axis=(1, 2, 3)) - 128).max() < 0.6
    strong = pictures[np.argsort(deviation)[-2:]] - 128
    assert abs(np.corrcoef(strong.reshape(2, -1))[0, 1]) < 0.05
