"""Training on logs in a store: the samples, their order and the weights of the same logs on a disk."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from common.errors import StoreError, UserError
from dataset import DatasetError, IndexConfig, Samples, build_index
from dataset.loader.loader import Loader, load
from model.training.trainer import train
from recorder.log.training_copies import bring_here
from tests.helpers.bucket import Bucket
from tests.helpers.logs import write_log
from tests.helpers.toy import SMALL, STEERING, road

CONFIG = IndexConfig(flip=False, max_uses=1, block_s=0.5, gap_s=0)


@pytest.fixture
def indexes(bucket: Bucket, tmp_path: Path) -> tuple[Path, Path]:
    """Of the same sessions, on the disk and in the store."""
    write_log(bucket.folder / "toy.mcap", STEERING, road, cameras=["center"])
    write_log(bucket.folder / "more.mcap", STEERING, lambda _, row: road("center", 39 - row), start_ns=10**18)
    disk = build_index(sorted(bucket.folder.glob("*.mcap")), tmp_path / "disk", CONFIG).path
    store = build_index([bucket.url("more.mcap"), bucket.url("toy.mcap")], tmp_path / "store", CONFIG).path
    return disk, store


def cached(tmp_path: Path) -> list[Path]:
    return sorted((tmp_path / "cache" / "logs").glob("*.mcap"))


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
    config = replace(SMALL, epochs=2)
    train(disk, tmp_path / "runs/disk", config)
    bucket.delay_s = 0.01
    bucket.fail_each_once()
    bucket.requests.clear()
    train(store, tmp_path / "runs/half", replace(SMALL, epochs=1))
    shutil.rmtree(tmp_path / "cache")
    bucket.fail_each_once()
    train(store, tmp_path / "runs/half", config, resume=True)
    assert gets(bucket) >= 2 * 2 * 2 * 2  # of two trainings and two logs, at least two requests, each twice
    weights = [(tmp_path / f"runs/{name}/model.safetensors").read_bytes() for name in ("disk", "half")]
    assert weights[0] == weights[1]


def test_a_log_comes_once_and_whole(bucket: Bucket, indexes: tuple[Path, Path], tmp_path: Path) -> None:
    _, store = indexes
    bucket.requests.clear()
    first = pictures(load(store, batch=7, budget_bytes=0), epochs=3)
    opened = 2 * 3  # the end, the start, and what lies before the end, of each log
    assert gets(bucket) <= opened + 2
    logs = sorted(bucket.folder.glob("*.mcap"))
    assert sorted(path.read_bytes() for path in cached(tmp_path)) == sorted(path.read_bytes() for path in logs)
    bucket.requests.clear()
    assert pictures(load(store, batch=7, budget_bytes=0), epochs=3) == first
    assert gets(bucket) <= opened


def test_a_copy_that_is_damaged_cut_or_gone_is_fetched_anew(
    bucket: Bucket, indexes: tuple[Path, Path], tmp_path: Path
) -> None:
    _, store = indexes
    expected = pictures(load(store, batch=7, budget_bytes=0))
    damaged, cut = cached(tmp_path)
    whole = damaged.read_bytes()
    at = len(whole) // 2
    damaged.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    cut.write_bytes(cut.read_bytes()[: len(whole) // 3])
    with load(store, batch=7, budget_bytes=0) as loader:
        list(loader.epoch(1))
        assert len(loader.skipped) > 0
    assert not damaged.exists()
    assert pictures(load(store, batch=7, budget_bytes=0)) == expected
    assert damaged.read_bytes() == whole
    with load(store, batch=7, budget_bytes=0) as loader:
        for path in cached(tmp_path):
            path.unlink()
        learnt = [batch.pictures.tobytes() for batch in loader.epoch(1)]
        assert learnt == [data for data, _ in expected[: loader.batches]]


def test_without_room_for_the_logs_the_error_reports_what_to_give(
    indexes: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = sum(path.stat().st_size for path in (tmp_path / "server").rglob("*.mcap"))
    monkeypatch.setenv("BC_CACHE_GB", f"{(size - 1) / 1e9:.9f}")
    with pytest.raises(UserError, match=r"GB of logs have to be fetched to it, but .*BC_CACHE_GB sets how much"):
        load(indexes[1])
    monkeypatch.setenv("BC_CACHE_GB", "many")
    with pytest.raises(UserError, match="BC_CACHE_GB=many: expected a number of gigabytes"):
        load(indexes[1])
    monkeypatch.delenv("BC_CACHE_GB")
    usage = shutil.disk_usage(tmp_path)._replace(free=10**9 + size - 1)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    with pytest.raises(UserError, match="the disk has no more room"):
        load(indexes[1])
    assert not cached(tmp_path)


def test_a_cache_that_cannot_be_written_reports_so(indexes: tuple[Path, Path], tmp_path: Path) -> None:
    shutil.rmtree(tmp_path / "cache", ignore_errors=True)
    (tmp_path / "cache").write_text("no folder")
    with pytest.raises(UserError, match=r"cache: logs cannot be fetched to it .*BC_CACHE names another folder"):
        load(indexes[1])


def test_logs_that_were_not_used_for_longest_make_room(
    indexes: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load(indexes[1]).close()
    used = cached(tmp_path)
    for number, name in enumerate(("older", "newer")):
        path = tmp_path / "cache" / "logs" / f"{name}.mcap"
        path.write_bytes(bytes(200_000))
        os.utime(path, (1000 + number, 1000 + number))
    (tmp_path / "cache" / "logs" / "killed.mcap.0a1b2c.part").write_bytes(bytes(9))
    lost = used[0].stat().st_size
    used[0].unlink()
    held = used[1].stat().st_size + 2 * 200_000
    monkeypatch.setenv("BC_CACHE_GB", f"{(held + lost - 1) / 1e9:.9f}")
    load(indexes[1]).close()
    assert {path.name for path in (tmp_path / "cache" / "logs").iterdir()} == {
        ".lock",
        "newer.mcap",
        *(path.name for path in used),
    }


def test_a_store_that_fails_while_a_log_comes_leaves_nothing(
    bucket: Bucket, indexes: tuple[Path, Path], tmp_path: Path
) -> None:
    with Samples(indexes[1]) as samples:
        bucket.answer = lambda handler: bool(handler.fail(403, "ExpiredToken"))
        with pytest.raises(StoreError, match=r"s3://logs: the credentials are not valid \(ExpiredToken\)"):
            bring_here(samples.logs.values())
    assert [path.name for path in (tmp_path / "cache" / "logs").iterdir()] == [".lock"]


def test_a_log_that_was_replaced_is_refused(bucket: Bucket, indexes: tuple[Path, Path]) -> None:
    (bucket.folder / "toy.mcap").unlink()
    write_log(bucket.folder / "toy.mcap", STEERING, cameras=["center"])
    with pytest.raises(DatasetError, match=r"s3://logs/toy.mcap: has changed since it was indexed"):
        load(indexes[1])
    (bucket.folder / "toy.mcap").unlink()
    with pytest.raises(DatasetError, match=r"s3://logs/toy.mcap: no such object"):
        load(indexes[1])
