"""Batches for a CPU, and for a GPU that has room for all crops or has not: the same samples, the same pictures.

All of it runs on a CPU here, which takes the place of the GPU; only pinned memory and streams are a GPU's own.
"""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from torch import Tensor

from dataset import IndexConfig, Loader, build_index, decode, load, preprocess
from dataset.alterations import ALTERATIONS, alter
from dataset.config import EPOCH_ALTERATIONS
from dataset.picture_spec import PictureSpec
from dataset.preprocessing import Image
from model.training.batches import KeptBatches, StreamedBatches, make_batches, needed_bytes
from tests.helpers.logs import write_log
from tests.helpers.udacity import scene

CPU = torch.device("cpu")
STEERING = [round(-0.6 + 0.1 * row, 2) for row in range(12)]
BATCH = 32
Batches = KeptBatches | StreamedBatches
MAKERS: list[Callable[[Loader, torch.device], Batches]] = [KeptBatches, StreamedBatches]


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
    images: Image = pictures.permute(0, 2, 3, 1).numpy()
    return images


# The same as the loader gives


def test_batches_for_a_cpu_are_those_of_the_loader(index: Path) -> None:
    with load(index, batch=BATCH) as loader:
        batches = make_batches(loader, CPU)
        for batch, (pictures, steering) in zip(loader.epoch(2), batches.epoch(2), strict=True):
            assert pictures.is_contiguous(memory_format=torch.channels_last)
            assert (pixels(pictures) == batch.pictures).all()
            assert steering.tolist() == batch.steering.tolist()


def test_crops_on_the_device_give_the_batches_of_the_loader(index: Path) -> None:
    rows = rows_of(index)
    with load(index, batch=BATCH, seed=5) as loader:
        batches = KeptBatches(loader, CPU)
        for epoch in (1, 2, 4):
            parts = loader.parts(epoch)
            expected = loader.epoch(epoch)
            for part, batch, (pictures, steering) in zip(parts, expected, batches.epoch(epoch), strict=True):
                assert (pictures.dtype, steering.dtype) == (torch.uint8, torch.float32)
                assert pictures.shape == (len(part), 3, 128, 128)
                assert pictures.is_contiguous(memory_format=torch.channels_last)
                assert steering.tolist() == [np.float32(rows[sample]["label"]) for sample in part]
                assert (pixels(pictures) == batch.pictures).all()


# Bringing the crops there


def test_the_memory_needed_is_that_of_the_crops_and_a_little(index: Path) -> None:
    with load(index, batch=BATCH) as loader:
        rows = rows_of(index)
        altered = sum(row["alteration"] != "" for row in rows)
        plain = {(row["camera"], row["row"]) for row in rows if row["alteration"] == ""}
        assert altered > 20
        crops = (len(plain) + altered) * 128 * 128 * 3
        assert crops <= needed_bytes(loader) < crops + 20 * len(loader)


@pytest.mark.parametrize(("spare_bytes", "kind"), [(0, KeptBatches), (-1, StreamedBatches)])
def test_a_device_that_has_room_for_all_crops_gets_them(
    index: Path, spare_bytes: int, kind: type[KeptBatches | StreamedBatches]
) -> None:
    elsewhere = torch.device("meta")  # any device that is no CPU; this one has no memory and computes nothing
    with load(index, batch=BATCH) as loader:
        batches = make_batches(loader, elsewhere, budget_bytes=needed_bytes(loader) + spare_bytes)
        assert type(batches) is kind
        for pictures, steering in batches.epoch(1):
            assert (pictures.device, steering.device) == (elsewhere, elsewhere)


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
    shutil.copy(index.parent / "lake.mcap", tmp_path)
    rows = rows_of(tmp_path / "index")
    with load(tmp_path / "index", batch=BATCH, threads=1) as loader:
        order = loader.order(1)
        shown = np.concatenate([pixels(pictures) for pictures, _ in KeptBatches(loader, CPU).epoch(1)])
    for sample, picture in zip(order, shown, strict=True):
        row = rows[sample]
        crop = preprocess(decode(scene(row["camera"], row["row"])))
        mirrored = np.ascontiguousarray(crop[:, ::-1]) if row["flip"] else crop
        assert (picture == alter(mirrored, row["alteration"], row["seed"])).all()


# Altered in every epoch


def test_a_device_alters_as_the_loader_does(index: Path) -> None:
    """But for rounding, and for pixels at the edge of a shadow."""
    with load(index, batch=BATCH, alter_each_epoch=EPOCH_ALTERATIONS) as loader:
        device = KeptBatches(loader, CPU)
        for epoch, start in ((1, 0), (2, 0), (2, 2), (4, 0)):
            pairs = zip(loader.epoch(epoch, start), device.epoch(epoch, start), strict=True)
            for batch, (pictures, steering) in pairs:
                assert pictures.dtype == torch.uint8
                assert pictures.is_contiguous(memory_format=torch.channels_last)
                assert steering.tolist() == batch.steering.tolist()
                off = np.abs(pixels(pictures).astype(int) - batch.pictures)
                assert (off <= 2).mean() > 0.99
                assert off.mean() < 0.5


def test_colours_in_another_order_are_altered_by_the_loader(index: Path) -> None:
    elsewhere = torch.device("meta")
    with load(index, alter_each_epoch=("noise",), seen=PictureSpec(channels="YUV")) as loader:
        assert type(make_batches(loader, elsewhere, budget_bytes=1 << 40)) is StreamedBatches
    with load(index, alter_each_epoch=("noise",)) as loader:
        assert type(make_batches(loader, elsewhere, budget_bytes=1 << 40)) is KeptBatches
