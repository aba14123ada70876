"""Loading an index: the same batches for any number of processes and from any batch on, PyTorch's own DataLoader,
and what happens when the index or its logs are not what they were."""

from __future__ import annotations

import contextlib
import functools
import itertools
import json
import pickle
import shutil
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from common.car import CAMERAS, Camera
from dataset import (
    Batch,
    DatasetError,
    IndexConfig,
    SamplesDataset,
    build_index,
    decode,
    load,
    preprocess,
)
from dataset.alterations import alter
from dataset.preprocessing import Image
from tests.helpers.driving import run_code
from tests.helpers.logs import plain_read, write_log
from tests.helpers.udacity import jpeg

STEERING = [round(-0.6 + 0.05 * row, 2) for row in range(24)]
BATCH = 16


def grey(camera: Camera, row: int) -> bytes:
    """A picture of its own for every camera and row."""
    return jpeg(20 + 3 * (3 * row + CAMERAS.index(camera)), 1 + 3 * row + CAMERAS.index(camera))


def white(camera: Camera, row: int) -> bytes:
    return jpeg(240, 1 + 3 * row + CAMERAS.index(camera))


def itself(picture: bytes, _camera: Camera, _row: int) -> bytes:
    return picture


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drives")
    logs = [
        write_log(folder / "lake.mcap", STEERING, grey),
        write_log(folder / "jungle.mcap", STEERING[:9], white),
    ]
    return build_index(logs, folder / "index", IndexConfig(block_s=0.5, gap_s=0)).path


@pytest.fixture
def own(index: Path, tmp_path: Path) -> Path:
    """An index and its logs that a test may damage."""
    shutil.copytree(index.parent, tmp_path / "own")
    return tmp_path / "own" / "index"


def rows_of(index: Path, split: str = "train") -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = pq.read_table(index / "samples.parquet").to_pylist()
    return [row for row in rows if row["split"] == split]


def shown(index: Path, row: dict[str, Any]) -> Image:
    """What a row of the index stands for, from the log's bytes."""
    log = index.parent / f"{row['session']}.mcap"
    crop = preprocess(decode(plain_read(log, row["offset"], row["length"])))
    return alter(np.ascontiguousarray(crop[:, ::-1]) if row["flip"] else crop, row["alteration"], row["seed"])


def content(batch: Batch) -> tuple[bytes, bytes]:
    return batch.pictures.tobytes(), batch.steering.tobytes()


# Batches


def test_an_epoch_is_every_sample_once_each_as_the_index_reports(index: Path) -> None:
    expected = rows_of(index)
    assert any(row["alteration"] for row in expected)
    assert {row["session"] for row in expected} == {"lake", "jungle"}
    with load(index, batch=BATCH) as loader:
        order = loader.order(3)
        assert sorted(order.tolist()) == list(range(len(expected)))
        assert (len(loader), loader.batches) == (len(expected), -(-len(expected) // BATCH))
        batches = list(loader.epoch(3))
    assert [len(batch.steering) for batch in batches[:-1]] == [BATCH] * (len(batches) - 1)
    pictures = np.concatenate([batch.pictures for batch in batches])
    steering = np.concatenate([batch.steering for batch in batches])
    assert (str(pictures.dtype), str(steering.dtype)) == ("uint8", "float32")
    for at, picture, value in zip(order, pictures, steering, strict=True):
        assert value == np.float32(expected[at]["label"])
        assert (picture == shown(index, expected[at])).all()


def test_the_order_is_a_function_of_seed_and_epoch(index: Path) -> None:
    def order(seed: int, epoch: int) -> tuple[int, ...]:
        with load(index, seed=seed) as loader:
            return tuple(loader.order(epoch).tolist())

    with load(index, seed=5) as used:
        list(used.epoch(0))
        assert tuple(used.order(3).tolist()) == order(5, 3)
    assert len({order(seed, epoch) for seed in (0, 5) for epoch in (0, 1, 2)}) == 6


def test_an_epoch_goes_on_from_any_batch(index: Path) -> None:
    with load(index, batch=BATCH) as loader:
        whole = [content(batch) for batch in loader.epoch(1)]
    assert len(set(whole)) == len(whole) > 3
    for start in range(len(whole) + 1):
        with load(index, batch=BATCH) as resumed:
            assert [content(batch) for batch in resumed.epoch(1, start_batch=start)] == whole[start:]


def test_threads_and_memory_change_nothing(index: Path) -> None:
    def epochs(**settings: Any) -> list[tuple[bytes, bytes]]:
        with load(index, batch=BATCH, **settings) as loader:
            return [content(batch) for epoch in (1, 2) for batch in loader.epoch(epoch)]

    expected = epochs()
    assert epochs(threads=1) == expected
    assert epochs(threads=5, budget_bytes=0) == expected
    assert epochs(threads=2, budget_bytes=10 * 49_152) == expected


def test_a_picture_that_fits_the_memory_is_read_once(own: Path) -> None:
    """The first epoch has seen every picture: what then happens to the log is not noticed."""
    with load(own, batch=BATCH) as loader:
        first = Counter(picture.tobytes() for batch in loader.epoch(1) for picture in batch.pictures)
        for log in own.parent.glob("*.mcap"):
            with log.open("rb+") as stream:
                stream.truncate(100)
        assert Counter(picture.tobytes() for batch in loader.epoch(2) for picture in batch.pictures) == first
    with pytest.raises(DatasetError):
        load(own)


def test_an_epoch_may_be_left_in_its_middle(index: Path) -> None:
    threads = threading.active_count()
    with load(index, batch=BATCH) as loader:
        for batch in loader.epoch(1):
            first = content(batch)
            break
        assert threading.active_count() == threads
        assert content(next(iter(loader.epoch(1)))) == first


def test_batches_belong_to_whoever_got_them(index: Path) -> None:
    with load(index, batch=BATCH) as loader:
        first, *_ = kept = list(loader.epoch(1))
        before = [content(batch) for batch in kept]
        first.pictures[:] = 0
        assert [content(batch) for batch in loader.epoch(1)] == before
        assert [content(batch) for batch in kept[1:]] == before[1:]


def test_pictures_at_the_same_place_of_two_logs_are_not_mixed_up(tmp_path: Path) -> None:
    first, second = next(
        pair for pair in itertools.combinations(map(jpeg, range(256)), 2) if len(pair[0]) == len(pair[1])
    )
    for name, picture in (("lake", first), ("jungle", second)):
        write_log(tmp_path / f"{name}.mcap", [0.0], functools.partial(itself, picture))
    build_index([tmp_path / "lake.mcap", tmp_path / "jungle.mcap"], tmp_path / "index", IndexConfig(flip=False))
    rows = rows_of(tmp_path / "index")
    assert len({row["offset"] for row in rows}) == len(rows) // 2
    with load(tmp_path / "index") as loader:
        [batch] = loader.in_order()
    for picture, row in zip(batch.pictures, rows, strict=True):
        assert (picture == shown(tmp_path / "index", row)).all()


def test_the_driving_view_is_what_the_car_sees(index: Path) -> None:
    expected = [
        row
        for row in rows_of(index, "validation")
        if row["camera"] == "center" and not row["flip"] and not row["copy"]
    ]
    with load(index, "validation", driving_view=True) as loader:
        [batch] = loader.in_order()
    assert batch.steering.tolist() == np.array([row["recorded"] for row in expected], np.float32).tolist()
    for picture, row in zip(batch.pictures, expected, strict=True):
        assert (picture == shown(index, row)).all()


def test_one_sample_is_one_batch_and_a_split_without_samples_is_none(tmp_path: Path) -> None:
    log = write_log(tmp_path / "lake.mcap", [0.3], grey, cameras=["center"])
    build_index([log], tmp_path / "index", IndexConfig(flip=False))
    with load(tmp_path / "index") as loader:
        [batch] = loader.epoch(1)
        assert (batch.pictures.shape, batch.steering.tolist()) == ((1, 128, 128, 3), [np.float32(0.3)])
    for driving_view in (False, True):
        with load(tmp_path / "index", "validation", driving_view=driving_view) as none:
            assert (len(none), none.batches, list(none.epoch(1))) == (0, 0, [])
    dataset = SamplesDataset(tmp_path / "index", "validation")
    assert len(dataset) == 0
    dataset.close()


@pytest.mark.parametrize(
    "bad",
    [
        {"batch": 0},
        {"seed": -1},
        {"threads": -1},
        {"budget_bytes": -1},
        {"split": "test"},
    ],
)
def test_arguments_that_make_no_sense_are_refused(index: Path, bad: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        load(index, **bad)


# PyTorch's own DataLoader


IN_WORKERS = """
import numpy as np
from torch.utils.data import DataLoader
from dataset import SamplesDataset
with SamplesDataset({index!r}) as samples:
    samples[0]  # opened here, and again by each worker
    batches = list(DataLoader(samples, 50, num_workers=2, multiprocessing_context={context!r}))
np.savez({to!r}, *(np.concatenate([part.numpy() for part in parts]) for parts in zip(*batches)))
"""


@pytest.mark.parametrize("context", ["fork", pytest.param("spawn", marks=pytest.mark.long)])
def test_pytorchs_data_loader_gets_the_same_samples(index: Path, context: str, tmp_path: Path) -> None:
    """In a process of its own, as a user has it: a worker that is forked from one with many threads, as this one
    is, may crash."""
    to = tmp_path / "batches.npz"
    done = run_code(IN_WORKERS.format(index=str(index), context=context, to=str(to)))
    assert done.returncode == 0, done.stderr
    expected, (pictures, steering) = rows_of(index), np.load(to).values()
    assert (str(pictures.dtype), str(steering.dtype)) == ("uint8", "float32")
    assert steering.tolist() == [np.float32(row["label"]) for row in expected]
    for picture, row in zip(pictures, expected, strict=True):
        assert (picture == shown(index, row)).all()


def test_a_dataset_is_pickled_for_a_worker_that_is_spawned(index: Path) -> None:
    with contextlib.closing(SamplesDataset(index)) as dataset:
        expected = dataset[5]
        with contextlib.closing(pickle.loads(pickle.dumps(dataset))) as sent:
            assert len(sent) == len(dataset)
            assert (sent[5][0] == expected[0]).all()
            assert sent[5][1] == expected[1]


# Logs and indexes that are not what they were


def gone(log: Path) -> None:
    log.unlink()


def replaced(log: Path) -> None:
    write_log(log, STEERING[::-1], grey, overwrite=True)


def cut(log: Path) -> None:
    log.write_bytes(log.read_bytes()[:-1000])


def garbage(log: Path) -> None:
    log.write_bytes(b"garbage" * 1000)


def link_to_another(log: Path) -> None:
    log.unlink()
    log.symlink_to("jungle.mcap")


CHANGES = [gone, replaced, cut, garbage, link_to_another]


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("opened", [load, SamplesDataset])
def test_a_log_that_is_not_what_was_indexed_is_refused(
    own: Path, change: Callable[[Path], None], opened: Callable[[Path], object]
) -> None:
    change(own.parent / "lake.mcap")
    with pytest.raises(DatasetError, match=r"lake.*session lake.*`bc-index`") as caught:
        opened(own)
    assert "\n" not in str(caught.value)


def test_a_worker_refuses_a_log_that_has_changed(own: Path) -> None:
    dataset = SamplesDataset(own)
    sent = pickle.dumps(dataset)
    dataset.close()
    replaced(own.parent / "lake.mcap")
    build_index([own.parent / "lake.mcap"], own)  # that the index is up to date again does not help
    with pytest.raises(DatasetError, match=r"lake\.mcap: has changed"):
        pickle.loads(sent)[0]


def test_changed_bytes_behind_an_unchanged_log_are_never_trained_on(own: Path) -> None:
    """Same size, same chunk headers, so the same fingerprint; the chunk's CRC tells."""
    log = own.parent / "lake.mcap"
    with log.open("rb+") as stream:
        stream.seek(rows_of(own)[0]["offset"] + 100)
        stream.write(b"\0\0\0\0")
    with load(own, batch=BATCH) as loader:
        learnt = sum(len(batch.steering) for batch in loader.epoch(1))
        assert len(loader.skipped) > 0
        assert learnt < len(loader)
        assert all("lake.mcap" in kind for kind, _ in loader.skipped)


def test_a_log_may_be_named_by_a_link_and_the_folder_may_move(own: Path, tmp_path: Path) -> None:
    expected = rows_of(own)
    log = own.parent / "lake.mcap"
    log.symlink_to(log.rename(log.with_name("far.mcap")).name)
    own.parent.rename(tmp_path / "renamed")
    with load(tmp_path / "renamed" / "index") as loader:
        assert len(loader) == len(expected)


def edited(index: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    pq.write_table(change(pq.read_table(index / "samples.parquet")), index / "samples.parquet")


def with_column(name: str, value: object, kind: pa.DataType) -> Callable[[pa.Table], pa.Table]:
    """The first value of a column is another one."""

    def change(table: pa.Table) -> pa.Table:
        at = table.schema.get_field_index(name)
        values = pa.array([value, *table[name].to_pylist()[1:]], kind)
        return table.set_column(at, name, values)

    return change


def with_metadata(**values: object) -> Callable[[pa.Table], pa.Table]:
    def change(table: pa.Table) -> pa.Table:
        stored = json.loads(table.schema.metadata[b"bc.index"])
        return table.replace_schema_metadata({b"bc.index": json.dumps({**stored, **values}).encode()})

    return change


@pytest.mark.parametrize(
    "change",
    [
        lambda table: table.drop_columns("offset"),
        lambda table: table.replace_schema_metadata(None),
        with_metadata(logs={}),
        with_column("session", "desert", pa.string()),
        with_column("alteration", "blur+fog", pa.string()),
        with_column("length", -1, pa.int64()),
        with_column("seed", -1, pa.int64()),
        with_column("label", 1.5, pa.float64()),
        with_column("flip", None, pa.bool_()),
    ],
)
def test_an_index_that_makes_no_sense_is_refused(own: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    edited(own, change)
    with pytest.raises(DatasetError, match=r"samples\.parquet: damaged.*remove it and run `bc-index`") as caught:
        load(own)
    assert "\n" not in str(caught.value)


def test_no_index_reports_how_to_build_one(tmp_path: Path) -> None:
    for opened in (load, SamplesDataset):
        with pytest.raises(DatasetError, match=r"no index; .*build it with `bc-index"):
            opened(tmp_path)
