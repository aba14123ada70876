"""Batches for a CPU, and for a GPU that has room for all crops or has not: the same samples, the same pictures.

All of it runs on a CPU here, which takes the place of the GPU; only pinned memory and streams are a GPU's own.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from torch import Tensor

from common.car import CAMERAS, Camera
from dataset import IndexConfig, Loader, build_index, load
from dataset.augment import ALTERATIONS, Blur, Brightness, Shadow, alter
from dataset.preprocess import Image
from logs import write_log
from model.training.batches import Batches, DeviceBatches, HostBatches, PinnedBatches, make_batches, needed_bytes
from model.training.device_augment import blurred, brightened, shaded

CPU = torch.device("cpu")
STEERING = [round(-0.6 + 0.1 * row, 2) for row in range(12)]
BATCH = 32
MAKERS: list[Callable[[Loader, torch.device], Batches]] = [DeviceBatches, PinnedBatches]


def scene(camera: Camera, row: int) -> bytes:
    """A picture of its own for every camera and row: coloured patches without symmetry."""
    random = np.random.default_rng((row, CAMERAS.index(camera)))
    picture = cv2.resize(random.integers(0, 256, (6, 9, 3), dtype=np.uint8), (320, 160))
    ok, encoded = cv2.imencode(".jpg", picture)
    assert ok
    return encoded.tobytes()


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Threads wait for each other where other tests run beside: these pictures are too few to be worth it."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drives")
    log = write_log(folder / "lake.mcap", STEERING, scene)
    return build_index([log], folder / "index", IndexConfig(block_s=0.3, gap_s=0, per_bin=6)).path


def rows_of(index: Path) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = pq.read_table(index / "samples.parquet").to_pylist()
    return [row for row in rows if row["split"] == "train"]


def pixels(pictures: Tensor) -> Image:
    """(N, 3, 128, 128) as (N, 128, 128, 3)."""
    found: Image = pictures.permute(0, 2, 3, 1).numpy()
    return found


def level_difference(one: Image, other: Image) -> Image:
    return np.abs(one.astype(np.int16) - other.astype(np.int16)).astype(np.uint8)


# The same as the loader gives


def test_on_a_cpu_nothing_is_copied(index: Path) -> None:
    with load(index, batch=BATCH) as loader:
        batches = make_batches(loader, CPU)
        assert isinstance(batches, HostBatches)
        for batch, (pictures, steering) in zip(loader.epoch(2), batches.epoch(2), strict=True):
            assert pictures.is_contiguous(memory_format=torch.channels_last)
            assert (pixels(pictures) == batch.pictures).all()
            assert steering.tolist() == batch.steering.tolist()


@pytest.mark.parametrize("ranks", [1, 3])
def test_crops_on_the_device_give_the_batches_of_the_loader(index: Path, ranks: int) -> None:
    rows = rows_of(index)
    unaltered: list[Image] = []
    bright: list[Image] = []
    other: list[Image] = []
    for rank in range(ranks):
        with load(index, batch=BATCH, seed=5, rank=rank, ranks=ranks) as loader:
            batches = DeviceBatches(loader, CPU)
            assert (len(batches), batches.batches) == (len(rows), -(-len(rows) // BATCH))
            for epoch in (1, 2):
                parts = loader.parts(epoch)
                expected = loader.epoch(epoch)
                for part, batch, (pictures, steering) in zip(parts, expected, batches.epoch(epoch), strict=True):
                    assert (pictures.dtype, steering.dtype) == (torch.uint8, torch.float32)
                    assert pictures.shape == (len(part), 3, 128, 128)
                    assert pictures.is_contiguous(memory_format=torch.channels_last)
                    assert steering.tolist() == [np.float32(rows[sample]["label"]) for sample in part]
                    off = level_difference(pixels(pictures), batch.pictures)
                    for sample, difference in zip(part, off, strict=True):
                        names = rows[sample]["alteration"]
                        kind = bright if "brightness" in names else other if names else unaltered
                        kind.append(difference)
    assert min(map(len, (unaltered, bright, other))) > 20
    assert not np.any(unaltered)  # mirrored or not
    assert np.max(other) <= 1
    assert np.max(bright) <= 2
    assert np.mean(np.array(bright) > 0) < 0.05


@pytest.mark.parametrize("ranks", [1, 2])
def test_copied_batches_are_those_of_the_loader(index: Path, ranks: int) -> None:
    for rank in range(ranks):
        with load(index, batch=BATCH, rank=rank, ranks=ranks) as loader:
            batches = PinnedBatches(loader, CPU)
            for batch, (pictures, steering) in zip(loader.epoch(1), batches.epoch(1), strict=True):
                assert pictures.is_contiguous(memory_format=torch.channels_last)
                assert (pixels(pictures) == batch.pictures).all()
                assert steering.tolist() == batch.steering.tolist()


@pytest.mark.parametrize("make", MAKERS)
def test_an_epoch_goes_on_from_any_batch(index: Path, make: Callable[[Loader, torch.device], Batches]) -> None:
    with load(index, batch=BATCH, rank=1, ranks=2) as loader:
        batches = make(loader, CPU)
        whole = [(pixels(pictures).tobytes(), steering.tolist()) for pictures, steering in batches.epoch(3)]
        assert len({pictures for pictures, _ in whole}) == batches.batches > 3
        for start in range(len(whole) + 1):
            rest = [
                (pixels(pictures).tobytes(), steering.tolist()) for pictures, steering in batches.epoch(3, start)
            ]
            assert rest == whole[start:]
        for start in (-1, len(whole) + 1):
            with pytest.raises(ValueError, match=str(start)):
                batches.epoch(3, start)


@pytest.mark.parametrize("make", MAKERS)
def test_a_batch_is_its_own_and_stays_what_it_is(
    index: Path, make: Callable[[Loader, torch.device], Batches]
) -> None:
    with load(index, batch=BATCH) as loader:
        batches = make(loader, CPU)
        kept = [pictures for pictures, _ in batches.epoch(1)]
        before = [pixels(pictures).tobytes() for pictures in kept]
        for pictures, _ in batches.epoch(2):
            pictures.zero_()
        assert [pixels(pictures).tobytes() for pictures in kept] == before
        assert [pixels(pictures).tobytes() for pictures, _ in batches.epoch(1)] == before


def test_a_split_without_samples_has_no_batches(tmp_path: Path) -> None:
    log = write_log(tmp_path / "lake.mcap", [0.3], scene, cameras=["center"])
    build_index([log], tmp_path / "index", IndexConfig(flip=False))
    with load(tmp_path / "index", "validation") as loader:
        assert needed_bytes(loader) == 0
        for make in (*MAKERS, make_batches):
            assert list(make(loader, CPU).epoch(1)) == []
    with load(tmp_path / "index", rank=1, ranks=2) as loader:
        for make in (*MAKERS, make_batches):
            [(pictures, steering)] = make(loader, CPU).epoch(1)
            assert (pictures.shape, steering.shape) == ((0, 3, 128, 128), (0,))


# Bringing the crops there


def test_every_picture_is_read_once_and_told_of(index: Path) -> None:
    """Mirror images and copies show the same crop."""
    pictures = len({(row["offset"], row["camera"]) for row in rows_of(index)})
    told: list[int] = []
    with load(index, batch=8) as loader:
        assert loader.pictures == pictures < len(loader) / 2
        batches = DeviceBatches(loader, CPU, told.append)
        assert (sum(told), max(told)) == (pictures, 8)
        (index.parent / "lake.mcap").rename(index.parent / "away.mcap")  # nothing is opened again
        assert sum(len(steering) for _, steering in batches.epoch(1)) == len(loader)
        (index.parent / "away.mcap").rename(index.parent / "lake.mcap")


def test_the_memory_needed_is_that_of_the_crops_and_a_little(index: Path) -> None:
    with load(index, batch=BATCH) as loader:
        crops = loader.pictures * 128 * 128 * 3
        shadows = sum("shadow" in row["alteration"] for row in rows_of(index))
        assert crops + 2048 * shadows <= needed_bytes(loader) < crops + 2048 * shadows + 20 * len(loader)


@pytest.mark.parametrize(("spare_bytes", "kind"), [(0, DeviceBatches), (-1, PinnedBatches)])
def test_a_device_that_has_room_for_all_crops_gets_them(
    index: Path, spare_bytes: int, kind: type[DeviceBatches | PinnedBatches]
) -> None:
    elsewhere = torch.device("meta")  # any device that is no CPU; this one has no memory and computes nothing
    with load(index, batch=BATCH) as loader:
        batches = make_batches(loader, elsewhere, budget_bytes=needed_bytes(loader) + spare_bytes)
        assert type(batches) is kind
        for pictures, steering in batches.epoch(1):
            assert (pictures.device, steering.device) == (elsewhere, elsewhere)


def test_a_loader_fills_the_memory_that_it_is_given(index: Path) -> None:
    """As a GPU needs it, which copies by itself only out of memory that never moves."""
    given: list[Image] = []

    def allocate(shape: tuple[int, ...]) -> Image:
        given.append(np.empty(shape, np.uint8))
        return given[-1]

    with load(index, batch=BATCH) as loader:
        loader.use_memory(allocate)
        for _ in range(3):
            for batch in loader.epoch(1):
                assert any(np.shares_memory(batch.pictures, memory) for memory in given)
        assert len(given) < 2 * loader.batches  # used again


# Alterations


@pytest.fixture(scope="module")
def pictures() -> Image:
    """Noise, in which neighbours differ as much as they can; smooth colours; greys; and the extremes."""
    random = np.random.default_rng(0)
    noise = random.integers(0, 256, (6, 128, 128, 3), dtype=np.uint8)
    smooth = np.stack([cv2.resize(picture[:5, :7], (128, 128)) for picture in noise])
    grey = np.broadcast_to(np.arange(0, 256, 2, dtype=np.uint8)[None, :, None, None], (1, 128, 128, 3))
    pure = 255 * (np.arange(128) // 16 >> np.arange(3)[:, None] & 1).astype(np.uint8)  # all 8 pure colours
    corners = np.broadcast_to(pure.T[None, None], (1, 128, 128, 3))
    return np.concatenate([noise, smooth, grey, corners])


@pytest.mark.parametrize("kernel_px", [3, 5, 7, 9])
def test_blur_agrees_with_opencv(pictures: Image, kernel_px: int) -> None:
    expected = np.stack([Blur(kernel_px).apply(picture) for picture in pictures])
    assert level_difference(blurred(torch.from_numpy(pictures), kernel_px).numpy(), expected).max() <= 1


def test_brightness_agrees_with_opencv(pictures: Image) -> None:
    different = []
    for factor in (0.4, 0.77, 1.0, 1.234, 1.6):
        expected = np.stack([Brightness(factor).apply(picture) for picture in pictures])
        found = brightened(torch.from_numpy(pictures), torch.full((len(pictures),), factor)).numpy()
        different.append(level_difference(found, expected))
    assert np.max(different) <= 2
    assert np.mean(np.array(different) > 0) < 0.05


def test_shadows_are_those_of_opencv_to_the_last_edge(pictures: Image) -> None:
    drawn = [Shadow.draw(np.random.default_rng(seed), 128, 128) for seed in range(len(pictures))]
    expected = np.stack([shadow.apply(picture) for shadow, picture in zip(drawn, pictures, strict=True)])
    masks = torch.from_numpy(np.stack([shadow.mask for shadow in drawn]) > 0)
    factors = torch.tensor([shadow.factor for shadow in drawn])
    assert (shaded(torch.from_numpy(pictures), masks, factors).numpy() == expected).all()


def test_alterations_come_in_the_order_of_the_index_whatever_it_is(index: Path, tmp_path: Path) -> None:
    """An index with `--alter shadow blur` has another order; here are all orders in one."""
    orders = ["+".join(names) for count in (1, 2, 3) for names in itertools.permutations(ALTERATIONS, count)]
    table = pq.read_table(index / "samples.parquet")
    names = pa.array([orders[number % len(orders)] for number in range(len(table))])
    table = table.set_column(table.schema.get_field_index("alteration"), "alteration", names)
    seeds = pa.array(range(len(table)), pa.int64())
    table = table.set_column(table.schema.get_field_index("seed"), "seed", seeds)
    (tmp_path / "index").mkdir()
    pq.write_table(table, tmp_path / "index" / "samples.parquet")
    (tmp_path / "lake.mcap").symlink_to(index.parent / "lake.mcap")
    rows = rows_of(tmp_path / "index")
    with load(tmp_path / "index", batch=BATCH, threads=1) as loader:
        plain = {
            number: crop.copy()
            for numbers, crops in loader.crops()
            for number, crop in zip(numbers.tolist(), crops, strict=True)
        }
        order = loader.order(1)
        found = np.concatenate([pixels(pictures) for pictures, _ in DeviceBatches(loader, CPU).epoch(1)])
        picture_of = loader.rows.picture
    off = []
    for sample, picture in zip(order, found, strict=True):
        crop = plain[picture_of[sample]]
        mirrored = np.ascontiguousarray(crop[:, ::-1]) if rows[sample]["flip"] else crop
        expected = alter(mirrored, rows[sample]["alteration"], rows[sample]["seed"])
        off.append(level_difference(picture, expected))
    assert np.max(off) <= 2
    assert np.mean(np.array(off) > 0) < 0.05
