"""`bc-index --sessions s3://...`: the index of the same logs on a disk, but for the places; what it moves."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from dataset import IndexConfig, Samples, build_index
from dataset.cli import main
from recorder import Log
from recorder.log.tags import Tag, add_tags
from tests.helpers.bucket import Bucket
from tests.helpers.layouts import mixed
from tests.helpers.logs import write_log
from tests.helpers.udacity import call

SETTINGS = ("--labels", "as-recorded", "--block-s", "1", "--gap-s", "0")
NOISE = bytes(range(256)) * 16


def drive(path: Path, number: int = 0) -> Path:
    """A log of 100 rows, 1.2 MB of pictures."""
    steering = [math.sin((row + 9 * number) / 7) for row in range(100)]
    return write_log(
        path,
        steering,
        lambda camera, row: f"{number} {camera} {row}".encode() + NOISE,
        start_ns=(1 + number) << 50,
    )


def index_of(sessions: object, index: str, *flags: str) -> int:
    return call(main, *flags, "--sessions", sessions, "--index", index, *SETTINGS)


def test_the_index_is_that_of_the_same_logs_on_a_disk(bucket: Bucket, tmp_path: Path) -> None:
    for number in range(3):
        drive(bucket.folder / f"{number}.mcap", number)
    with Log(bucket.folder / "1.mcap") as log:
        add_tags(bucket.folder / "1.mcap", log.fingerprint, [Tag(10, 20, "exclude")])
    assert index_of(bucket.folder, "disk") == 0
    assert index_of(bucket.url(), "store") == 0
    assert pq.read_table("disk/samples.parquet").equals(pq.read_table("store/samples.parquet"))
    for number in range(3):
        frames = [pq.read_table(f"{index}/frames/{number}.parquet") for index in ("disk", "store")]
        assert frames[0].equals(frames[1])
    with Samples("disk") as disk, Samples("store") as store:
        assert disk.fingerprint == store.fingerprint
        assert [log.path for log in store.sources.values()] == [f"s3://logs/{number}.mcap" for number in range(3)]
        assert {session: str(log.path) for session, log in store.logs.items()} == {
            str(number): f"s3://logs/{number}.mcap" for number in range(3)
        }


def test_pictures_stay_where_they_are(bucket: Bucket) -> None:
    size = sum(drive(bucket.folder / f"{number}.mcap", number).stat().st_size for number in range(3))
    assert index_of(bucket.url(), "store") == 0
    assert size > 3.6e6
    assert bucket.bytes_sent < 0.6e6


def test_logs_that_have_not_changed_cost_a_listing(bucket: Bucket) -> None:
    for number in range(3):
        drive(bucket.folder / f"{number}.mcap", number)
    assert index_of(bucket.url(), "store") == 0
    bucket.requests.clear()
    assert index_of(bucket.url(), "store") == 0
    assert [path.partition("?")[0] for _, path, _ in bucket.requests] == ["/logs", "/logs"]


@pytest.mark.parametrize("change", ["another log", "tags"])
def test_what_has_changed_is_read_again(bucket: Bucket, change: str, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [drive(bucket.folder / f"{number}.mcap", number) for number in range(2)]
    assert index_of(bucket.url(), "store") == 0
    if change == "tags":
        with Log(paths[1]) as log:
            add_tags(paths[1], log.fingerprint, [Tag(0, 5, "exclude")])
    else:
        paths[1].unlink()
        drive(paths[1], 7)
    bucket.requests.clear()
    capsys.readouterr()
    assert index_of(bucket.url(), "store") == 0
    assert not [path for _, path, _ in bucket.requests if "/0.mcap" in path]
    assert index_of(bucket.folder, "disk") == 0
    assert pq.read_table("disk/samples.parquet").equals(pq.read_table("store/samples.parquet"))


def test_sessions_are_named_as_on_a_disk(bucket: Bucket, capsys: pytest.CaptureFixture[str]) -> None:
    drive(bucket.folder / "lake.mcap")
    drive(bucket.folder / "mine.mcap", 1)
    assert index_of(bucket.url(), "one", "mine") == 0
    assert index_of(bucket.folder, "two", "s3://logs/mine.mcap") == 0
    assert pq.read_table("one/samples.parquet").equals(pq.read_table("two/samples.parquet"))
    capsys.readouterr()
    assert call(main, "lakes", "--sessions", bucket.url()) == 1
    assert "did you mean lake?" in capsys.readouterr().err


def test_a_store_that_does_not_answer_changes_no_index(bucket: Bucket, capsys: pytest.CaptureFixture[str]) -> None:
    drive(bucket.folder / "0.mcap")
    assert index_of(bucket.url(), "store") == 0
    before = Path("store/samples.parquet").read_bytes()
    drive(bucket.folder / "1.mcap", 1)
    bucket.answer = lambda handler: "1.mcap" in handler.path and bool(handler.fail(403, "AccessDenied"))
    assert index_of(bucket.url(), "store") == 1  # it may well be sound: nothing is left out for it
    assert "s3://logs/1.mcap" in capsys.readouterr().err
    assert Path("store/samples.parquet").read_bytes() == before


def test_two_machines_may_index_one_bucket_at_once(bucket: Bucket, tmp_path: Path) -> None:
    for number in range(2):
        drive(bucket.folder / f"{number}.mcap", number)
    before = {path.name: path.read_bytes() for path in bucket.folder.iterdir()}
    settings = IndexConfig(labels="as-recorded", block_s=1, gap_s=0)
    logs = [bucket.url("0.mcap"), bucket.url("1.mcap")]
    bucket.delay_s = 0.02
    with ThreadPoolExecutor() as machines:
        made = list(machines.map(lambda name: build_index(logs, tmp_path / name, settings).path, ("one", "two")))
    first, second = (pq.read_table(index / "samples.parquet") for index in made)
    assert first.equals(second)
    assert {path.name: path.read_bytes() for path in bucket.folder.iterdir()} == before


def test_an_old_log_costs_all_of_it_and_reports_so(bucket: Bucket, capsys: pytest.CaptureFixture[str]) -> None:
    size = mixed(drive(bucket.folder / "old.mcap")).stat().st_size
    assert index_of(bucket.url(), "store") == 0
    assert f"all {size / 1e6:,.0f} MB were downloaded; `bc-log rewrite`" in " ".join(
        capsys.readouterr().err.split()
    )
    assert size < bucket.bytes_sent < 2.5 * size  # once for where all is, once for the rows
