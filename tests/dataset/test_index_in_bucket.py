"""`bc-index --index s3://...`: written whole or not at all, by one machine at a time, and read from there."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import Any

import pytest

from common.location import Url
from common.random_access import open_for_reading
from common.store_record import Copy, StoreRecord, write_record
from common.stored_folder import StoredFolder
from dataset import Samples
from dataset.cli import main
from tests.helpers.bucket import Bucket
from tests.helpers.logs import write_log
from tests.helpers.udacity import call

INDEX = "s3://logs/index"


@pytest.fixture
def bucket(bucket: Bucket, monkeypatch: pytest.MonkeyPatch) -> Bucket:
    """With session 0."""
    use_machine("one", monkeypatch)
    drive(bucket, 0)
    return bucket


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
    contents = {}
    for path in (bucket.folder / "index").rglob("*"):
        with contextlib.suppress(FileNotFoundError):  # a part of one that the server is just writing
            if path.is_file():
                contents[path.relative_to(bucket.folder / "index").as_posix()] = path.read_bytes()
    return contents


def test_the_index_in_a_bucket_is_that_on_a_disk(bucket: Bucket, capsys: pytest.CaptureFixture[str]) -> None:
    assert index(place="disk") == 0
    told = capsys.readouterr()
    assert index() == 0
    assert capsys.readouterr().out.replace(INDEX, "disk") == told.out
    for name in ("samples.parquet", "frames/0.parquet"):
        assert files(bucket)[name] == (Path("disk") / name).read_bytes()
    with Samples(INDEX) as stored, Samples("disk") as local:
        assert stored.fingerprint == local.fingerprint


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


def let_another_machine_index(bucket: Bucket, monkeypatch: pytest.MonkeyPatch) -> dict[str, bytes]:
    """While this one puts samples.parquet there: the other one comes first, with session 1 alone. What it leaves
    there, once it was."""
    left: dict[str, bytes] = {}

    def meanwhile(handler: Any) -> bool:
        if handler.command == "PUT" and handler.path.endswith("index/samples.parquet"):
            bucket.answer = lambda handler: False
            use_machine("two", monkeypatch)
            assert index("1") == 0
            use_machine("one", monkeypatch)
            left.update(files(bucket))
        return False

    bucket.answer = meanwhile
    return left


@pytest.mark.parametrize("is_first", [pytest.param(True, marks=pytest.mark.long), False])
def test_of_two_machines_that_index_at_once_one_wins(
    bucket: Bucket, is_first: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if not is_first:
        assert index() == 0
    drive(bucket, 1)
    other = let_another_machine_index(bucket, monkeypatch)
    capsys.readouterr()
    assert index() == 1
    told = " ".join(capsys.readouterr().err.split())
    assert (
        "s3://logs/index/samples.parquet: another machine has changed it at the same time; its version stays"
        in told
    )
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
    assert "copy it to the store with `bc-log copy`" in " ".join(capsys.readouterr().err.split())
    assert files(bucket) == {}


def test_a_name_that_leads_elsewhere_is_refused(bucket: Bucket, capsys: pytest.CaptureFixture[str]) -> None:
    assert index() == 0
    (bucket.folder / "index/.hidden").write_text("x")  # other programs copy locks and the like along
    assert index() == 0
    assert not list(Path("caches").rglob(".hidden"))
    (bucket.folder / "index/C:x").write_text("x")
    assert index() == 1
    assert (
        f"{Url('s3', 'logs', 'index/C:x')}: no file on this machine can have this name" in capsys.readouterr().err
    )


def test_a_bucket_may_be_an_index_but_none_that_logs_are_in(
    bucket: Bucket, capsys: pytest.CaptureFixture[str]
) -> None:
    assert index(place="s3://logs") == 2
    assert "--index s3://logs/: contains the log s3://logs/sessions/0.mcap" in capsys.readouterr().err
    bucket.folder.with_name("indexes").mkdir()
    for _ in range(2):
        assert index(place="s3://indexes") == 0
        assert sessions("s3://indexes") == ["0"]
    assert not [path for path in Path("caches").rglob("*") if path.suffix == ".mcap"]


def test_a_record_in_a_copy_names_no_file_elsewhere(bucket: Bucket, tmp_path: Path) -> None:
    assert index() == 0
    mine = tmp_path / "mine"
    mine.write_text("mine")
    for name in ("../mine", str(mine), "a/../../mine"):
        copied = Copy(4, mine.stat().st_mtime_ns, "")
        (tmp_path / "copy").mkdir(exist_ok=True)
        write_record(tmp_path / "copy", StoreRecord(INDEX, {name: copied}))
        with StoredFolder(bucket.url("index"), tmp_path / "copy") as folder:
            folder.download()
        assert mine.read_text() == "mine"


def test_what_lies_behind_the_end_of_an_object_is_nothing_as_on_a_disk(bucket: Bucket, tmp_path: Path) -> None:
    size = 400_000
    (bucket.folder / "x").write_bytes(bytes(size))
    for place in (bucket.url("x"), bucket.folder / "x"):
        with contextlib.closing(open_for_reading(place)) as file:
            assert [len(file.read(at, 9)) for at in (size - 4, size, size + 4)] == [4, 0, 0]
            assert [len(data) for data in file.read_many([(9, size), (size + 4, 9)])] == [size - 9, 0]
