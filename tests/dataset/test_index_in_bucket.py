"""`bc-index --index s3://...`: written whole or not at all, by one machine at a time, and read from there."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bucket import Bucket, serving_bucket
from common.location import Url
from dataset import Samples
from dataset.cli import main
from logs import write_log
from udacity import call

INDEX = "s3://logs/index"


@pytest.fixture
def bucket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bucket]:
    monkeypatch.chdir(tmp_path)
    use_machine("one", monkeypatch)
    with serving_bucket(tmp_path / "server", monkeypatch) as served:
        drive(served, 0)
        yield served


def use_machine(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on commands are given on a machine of this name: it has a cache of its own."""
    monkeypatch.setenv("BC_CACHE", f"caches/{name}")


def drive(bucket: Bucket, number: int) -> None:
    steering = [math.sin((row + 9 * number) / 7) for row in range(60)]
    write_log(
        bucket.folder / f"sessions/{number}.mcap",
        steering,
        lambda camera, row: f"{number} {camera} {row}".encode(),
        start_ns=(1 + number) << 50,
    )


def index(*flags: str, place: str = INDEX) -> int:
    settings = ("--labels", "as-recorded", "--block-s", "1", "--gap-s", "0")
    return call(main, *flags, "--sessions", "s3://logs/sessions", "--index", place, *settings)


def sessions(place: str = INDEX) -> list[str]:
    with Samples(place) as samples:
        return list(samples.sources)


def files(bucket: Bucket) -> dict[str, bytes]:
    paths = (path for path in (bucket.folder / "index").rglob("*") if path.is_file())
    return {path.relative_to(bucket.folder / "index").as_posix(): path.read_bytes() for path in paths}


def test_the_index_in_a_bucket_is_that_on_a_disk(bucket: Bucket, capsys: pytest.CaptureFixture[str]) -> None:
    assert index(place="disk") == 0
    told = capsys.readouterr()
    assert index() == 0
    assert capsys.readouterr().out.replace(INDEX, "disk") == told.out
    for name in ("samples.parquet", "frames/0.parquet"):
        assert files(bucket)[name] == (Path("disk") / name).read_bytes()
    with Samples(INDEX) as there, Samples("disk") as here:
        assert there.fingerprint == here.fingerprint


def test_another_machine_reads_only_what_is_new(bucket: Bucket, monkeypatch: pytest.MonkeyPatch) -> None:
    assert index() == 0
    before = files(bucket)
    use_machine("two", monkeypatch)
    bucket.requests.clear()
    assert index("--check") == 0  # of what came down
    assert not [path for _, path, _ in bucket.requests if "0.mcap" in path]
    assert bucket.count("PUT") == bucket.count("DELETE") == 0
    assert files(bucket) == before
    drive(bucket, 1)
    bucket.requests.clear()
    assert index() == 0
    assert not [path for _, path, _ in bucket.requests if "0.mcap" in path]
    assert sessions() == ["0", "1"]


def test_a_session_that_has_gone_goes_there_too(bucket: Bucket) -> None:
    drive(bucket, 1)
    assert index() == 0
    (bucket.folder / "sessions/0.mcap").unlink()
    assert index() == 0
    assert sessions() == ["1"]
    assert [name for name in files(bucket) if name.startswith("frames/")] == ["frames/1.parquet"]


@pytest.mark.parametrize("is_first", [pytest.param(True, marks=pytest.mark.long), False])
def test_of_two_machines_that_index_at_once_one_wins_and_the_other_is_told(
    bucket: Bucket, is_first: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if not is_first:
        assert index() == 0
    drive(bucket, 1)

    def meanwhile(handler: Any) -> bool:
        if handler.command == "PUT" and handler.path.endswith("index/samples.parquet"):
            bucket.answer = lambda handler: False
            use_machine("two", monkeypatch)
            assert index("1") == 0
            use_machine("one", monkeypatch)
            other.update(files(bucket))
        return False

    other: dict[str, bytes] = {}
    bucket.answer = meanwhile
    capsys.readouterr()
    assert index() == 1
    told = " ".join(capsys.readouterr().err.split())
    assert "s3://logs/index/samples.parquet: was written by another machine meanwhile; that stays" in told
    assert files(bucket) == other
    assert sessions() == ["1"]
    assert index() == 0
    assert sessions() == ["0", "1"]


@pytest.mark.parametrize("fails_at", [pytest.param("samples.parquet", marks=pytest.mark.long), "frames/1.parquet"])
def test_an_upload_that_fails_leaves_an_index_and_the_next_one_mends_it(
    bucket: Bucket, fails_at: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert index() == 0
    drive(bucket, 1)
    bucket.answer = lambda handler: (
        handler.command == "PUT" and handler.path.endswith(fails_at) and bool(handler.fail(403, "AccessDenied"))
    )
    assert index() == 1
    assert "AccessDenied" in capsys.readouterr().err
    assert sessions() == (["0"] if fails_at == "samples.parquet" else ["0", "1"])
    bucket.answer = lambda handler: False
    use_machine("two", monkeypatch)
    assert index("--check") == 0
    assert sessions() == ["0", "1"]
    assert index(place="disk") == 0
    for name in ("samples.parquet", "frames/0.parquet", "frames/1.parquet"):
        assert files(bucket)[name] == (Path("disk") / name).read_bytes()


def test_logs_of_this_machine_are_not_indexed_there(bucket: Bucket, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(main, "--sessions", bucket.folder / "sessions", "--index", INDEX) == 2
    assert "`bc-log copy` it to the store" in " ".join(capsys.readouterr().err.split())
    assert files(bucket) == {}


def test_a_name_that_leads_elsewhere_is_refused(bucket: Bucket, capsys: pytest.CaptureFixture[str]) -> None:
    assert index() == 0
    (bucket.folder / "index/.hidden").write_text("x")
    assert index() == 1
    assert f"{Url('s3', 'logs', 'index/.hidden')}: a name that no file here may have" in capsys.readouterr().err
