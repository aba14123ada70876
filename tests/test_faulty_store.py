"""A store behind a bad connection: whichever request fails, nothing is lost, left over, or other than on disk."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from common.location import Url
from dataset import IndexConfig, build_index
from recorder import Log
from recorder.log.tags import Tag, add_tags, read_tags
from recorder.log_flag import logs_in
from recorder.upkeep.check import check
from recorder.upkeep.copy_log import copy_log
from tests.helpers.bucket import Bucket, end_uploads, in_parts_of, serving_bucket, unfinished_parts
from tests.helpers.faulty_proxy import FAULTS
from tests.helpers.logs import write_log
from tests.helpers.udacity import jpeg

SETTINGS = IndexConfig(labels="as-recorded", block_s=1, gap_s=0)
TAG = Tag(1, 2, "exclude")


@dataclass
class Store:
    """A bucket; on this machine, a folder with a log of 60 rows and its tags, its index, and what a test makes."""

    bucket: Bucket
    own: Path
    index: Path
    made: Path

    @property
    def url(self) -> Url:
        return self.bucket.url("a.mcap")


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Store]:
    folder = tmp_path_factory.mktemp("store")
    (folder / "here").mkdir()
    steering = [math.sin(row / 7) for row in range(60)]
    log = write_log(folder / "here/a.mcap", steering, lambda camera, row: jpeg(50 + row))
    with Log(log) as opened:
        add_tags(log, opened.fingerprint, [TAG])
    index = build_index([log], folder / "index", SETTINGS).path
    with pytest.MonkeyPatch.context() as patch, serving_bucket(folder / "server", patch) as bucket:
        yield Store(bucket, log.parent, index, folder / "made")


@pytest.fixture
def store(served: Store) -> Store:
    """The bucket holds what the folder does."""
    shutil.rmtree(served.made, ignore_errors=True)
    shutil.rmtree(served.bucket.folder)
    shutil.copytree(served.own, served.bucket.folder)
    end_uploads(served.bucket)
    served.bucket.pass_all()
    return served


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def upload(store: Store) -> None:
    copied = copy_log(store.own / "a.mcap", store.bucket.url("new/a.mcap"))
    assert (copied.is_new, copied.notice) == (True, "")
    assert files(store.bucket.folder / "new") == files(store.own)


def upload_in_parts(store: Store) -> None:
    with pytest.MonkeyPatch.context() as patch:
        in_parts_of(patch, -(-(store.own / "a.mcap").stat().st_size // 3))
        upload(store)
    assert unfinished_parts(store.bucket) == []


def download(store: Store) -> None:
    copied = copy_log(store.url, store.made / "a.mcap")
    assert (copied.is_new, copied.notice) == (True, "")
    assert files(store.made) == files(store.own)


def index(store: Store) -> None:
    build_index(logs_in(store.bucket.url()), store.made, SETTINGS)
    for name in ("samples.parquet", "frames/a.parquet"):
        assert pq.read_table(store.made / name).equals(pq.read_table(store.index / name))


def read(store: Store) -> None:
    (listed,) = logs_in(store.bucket.url())
    with Log(listed) as stored, Log(store.own / "a.mcap") as local:
        assert stored.problem == local.problem == ""
        assert stored.frames().equals(local.frames())
        assert stored.picture(30) == local.picture(30)
        assert read_tags(store.url, stored.fingerprint) == [TAG]
    assert check(store.url).findings == []


REQUESTS: dict[Callable[[Store], None], int] = {
    upload: 7,
    upload_in_parts: 9,
    download: 6,
    index: 7,
    read: 12,
}
"""What is done with a store, and how many requests that is."""

FAULTS_OF = {
    upload: ("lost", "cut"),
    upload_in_parts: ("lost",),
    download: ("cut", "truncated"),
    index: ("cut", "truncated"),
}


@pytest.mark.parametrize("work", REQUESTS)
def test_so_many_requests_are_tried(store: Store, work: Callable[[Store], None]) -> None:
    work(store)
    assert store.bucket.count() == REQUESTS[work]


@pytest.mark.parametrize(
    ("work", "fault", "number"),
    [
        (work, fault, number)
        for work, faults in FAULTS_OF.items()
        for fault in faults
        for number in range(REQUESTS[work])
    ],
)
def test_one_request_fails(store: Store, work: Callable[[Store], None], fault: str, number: int) -> None:
    store.bucket.fail_at(number, FAULTS[fault])
    work(store)
    assert store.bucket.count() > number


@pytest.mark.parametrize("work", REQUESTS)
def test_every_request_fails_the_first_time(store: Store, work: Callable[[Store], None]) -> None:
    store.bucket.fail_each_once()
    work(store)
    assert store.bucket.count() > REQUESTS[work]
