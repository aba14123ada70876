"""Training on logs in a store: the samples, their order and the weights of the same logs on a disk."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bucket import Bucket, serving_bucket
from common.errors import StoreError
from common.location import Location
from dataset import DatasetError, IndexConfig, build_index
from dataset.loader.loader import Loader, load
from logs import write_log
from model.evaluation.evaluate import evaluate
from model.training.trainer import train
from recorder.mcap.chunk_cache import ChunkCache
from toy import SMALL, STEERING, road

CONFIG = IndexConfig(flip=False, max_uses=1, block_s=0.5, gap_s=0)


@pytest.fixture
def bucket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bucket]:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    with serving_bucket(tmp_path / "server", monkeypatch) as served:
        yield served


@pytest.fixture
def indexes(bucket: Bucket, tmp_path: Path) -> tuple[Path, Path]:
    """Of the same sessions, on the disk and in the store."""
    write_log(bucket.folder / "toy.mcap", STEERING, road, cameras=["center"])
    write_log(bucket.folder / "more.mcap", STEERING, lambda _, row: road("center", 39 - row), start_ns=10**18)
    disk = build_index(sorted(bucket.folder.glob("*.mcap")), tmp_path / "disk", CONFIG).path
    store = build_index([bucket.url("more.mcap"), bucket.url("toy.mcap")], tmp_path / "store", CONFIG).path
    return disk, store


def cached(tmp_path: Path) -> list[Path]:
    return sorted(path for path in (tmp_path / "cache" / "chunks").rglob("*") if path.is_file())


def pictures(loader: Loader, epochs: int = 2) -> list[Any]:
    with loader:
        return [
            (batch.pictures.tobytes(), batch.steering.tobytes())
            for epoch in range(1, epochs + 1)
            for batch in loader.epoch(epoch)
        ]


def gets(bucket: Bucket) -> int:
    return bucket.count("GET")


def test_weights_from_a_store_are_those_from_a_disk_also_when_resumed(
    bucket: Bucket, indexes: tuple[Path, Path], tmp_path: Path
) -> None:
    disk, store = indexes
    train(disk, tmp_path / "runs/disk", SMALL)
    bucket.delay_s = 0.01
    bucket.fail_each_once()
    bucket.requests.clear()
    train(store, tmp_path / "runs/half", replace(SMALL, epochs=2))
    shutil.rmtree(tmp_path / "cache")
    bucket.fail_each_once()
    train(store, tmp_path / "runs/half", SMALL, resume=True)
    assert gets(bucket) >= 2 * 2 * 2 * 2  # of two trainings and two logs, at least two requests, each twice
    weights = [(tmp_path / f"runs/{name}/model.safetensors").read_bytes() for name in ("disk", "half")]
    assert weights[0] == weights[1]


def test_an_index_may_lie_in_the_store_beside_its_logs(
    bucket: Bucket, indexes: tuple[Path, Path], tmp_path: Path
) -> None:
    beside = build_index(sorted(bucket.folder.glob("*.mcap")), bucket.folder / "index", CONFIG).path
    (bucket.folder / "absolute").mkdir()
    shutil.copy(indexes[1] / "samples.parquet", bucket.folder / "absolute")
    expected = pictures(load(indexes[0], batch=7))
    for name in (beside.name, "absolute"):
        assert pictures(load(bucket.url(name), batch=7)) == expected
    with pytest.raises(DatasetError, match=r"s3://logs/none: no index"):
        load("s3://logs/none")


def test_divided_samples_in_a_store_train_as_those_on_a_disk(
    bucket: Bucket, indexes: tuple[Path, Path], tmp_path: Path
) -> None:
    logs = sorted(bucket.folder.glob("*.mcap"))
    disk = build_index(logs, tmp_path / "divided", CONFIG, divide_from_frames=1).path
    build_index(logs, bucket.folder / "divided", CONFIG, divide_from_frames=1)
    bucket.fail_each_once()
    runs = [tmp_path / "runs" / name for name in ("disk", "store")]
    places: tuple[Location, ...] = (disk, bucket.url("divided"))
    for place, run in zip(places, runs, strict=True):
        train(place, run, replace(SMALL, epochs=2))
    assert len({(run / "model.safetensors").read_bytes() for run in runs}) == 1
    there, here = (evaluate(runs[0], place).as_dict() for place in places)
    for found in (there, here):
        assert {session.pop("log") is None for session in found["sessions"].values()} == {False}
    assert there == here
    assert [path for method, path, _ in bucket.requests if method == "GET" and "/divided/samples/" in path]


def test_a_picture_comes_once_and_neighbours_together(
    bucket: Bucket, indexes: tuple[Path, Path], tmp_path: Path
) -> None:
    _, store = indexes
    bucket.requests.clear()
    first = pictures(load(store, batch=7, budget_bytes=0), epochs=3)
    opened = 2 * 3  # the end, the start, and what lies before the end, of each log
    assert gets(bucket) <= opened + 2  # all chunks of a log lie side by side
    assert cached(tmp_path)
    bucket.requests.clear()
    assert pictures(load(store, batch=7, budget_bytes=0), epochs=3) == first
    assert gets(bucket) <= opened


def test_a_cache_that_is_damaged_or_goes_is_fetched_anew(
    bucket: Bucket, indexes: tuple[Path, Path], tmp_path: Path
) -> None:
    _, store = indexes
    expected = pictures(load(store, batch=7, budget_bytes=0))
    damaged, cut = cached(tmp_path)
    whole = damaged.read_bytes()
    at = len(whole) // 2
    damaged.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    assert pictures(load(store, batch=7, budget_bytes=0)) == expected
    assert damaged.read_bytes() == whole
    cut.write_bytes(cut.read_bytes()[: len(whole) // 3])
    assert pictures(load(store, batch=7, budget_bytes=0)) == expected
    with load(store, batch=7, budget_bytes=0) as loader:
        list(loader.epoch(1))
        for path in cached(tmp_path):
            path.unlink()
        assert [batch.pictures.tobytes() for batch in loader.epoch(1)] == [
            each for each, _ in expected[: loader.batches]
        ]


def test_a_cache_that_is_too_small_says_so_and_gives_the_same(
    bucket: Bucket,
    indexes: tuple[Path, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    expected = pictures(load(indexes[0], batch=7, budget_bytes=0))
    monkeypatch.setenv("BC_CACHE_GB", "0.0001")
    with caplog.at_level(logging.WARNING):
        assert pictures(load(indexes[1], batch=7, budget_bytes=0)) == expected
    assert "BC_CACHE_GB=" in caplog.text


def test_a_cache_that_cannot_be_written_says_so_and_gives_the_same(
    bucket: Bucket, indexes: tuple[Path, Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    shutil.rmtree(tmp_path / "cache", ignore_errors=True)
    (tmp_path / "cache").write_text("no folder")
    expected = pictures(load(indexes[0], batch=7, budget_bytes=0))
    with caplog.at_level(logging.WARNING):
        assert pictures(load(indexes[1], batch=7, budget_bytes=0)) == expected
    assert caplog.text.count("cannot be written") == 1


def test_logs_that_were_not_used_for_longest_make_room(tmp_path: Path) -> None:
    folder = tmp_path / "small"
    for number in range(3):
        with ChunkCache(folder, 1 << 20).open(f"{number}" * 32) or pytest.fail("not opened") as kept:
            assert kept.keep(1 << 30, bytes([1 + number]) * 300_000)
        os.utime(next(folder.glob(f"{number}*")), (1000 + number, 1000 + number))
    cache = ChunkCache(folder, 1 << 20)
    with cache.open("new" * 16) or pytest.fail("not opened") as kept:
        assert kept.keep(0, bytes(300_000))
        assert sorted(path.name[0] for path in folder.iterdir()) == ["1", "2", "n"]
        written = sum(kept.keep(300_000 * number, b"x" * 300_000) for number in range(1, 9))
    assert written == 2  # nothing else has to go; what is in use stays
    assert [path.name[0] for path in folder.iterdir()] == ["n"]


def test_a_store_that_fails_for_good_ends_it_and_nothing_is_left_out(
    bucket: Bucket, indexes: tuple[Path, Path]
) -> None:
    with load(indexes[1], batch=7, budget_bytes=0) as loader:
        bucket.answer = lambda handler: bool(handler.fail(403, "ExpiredToken"))
        with pytest.raises(StoreError, match=r"s3://logs: credentials that are not valid \(ExpiredToken\)"):
            list(loader.epoch(1))
        assert len(loader.skipped) == 0


def test_a_log_that_was_replaced_is_refused(bucket: Bucket, indexes: tuple[Path, Path]) -> None:
    (bucket.folder / "toy.mcap").unlink()
    write_log(bucket.folder / "toy.mcap", STEERING, cameras=["center"])
    with pytest.raises(DatasetError, match=r"s3://logs/toy.mcap: has changed since it was indexed"):
        load(indexes[1])
    (bucket.folder / "toy.mcap").unlink()
    with pytest.raises(DatasetError, match=r"s3://logs/toy.mcap: no such object"):
        load(indexes[1])
