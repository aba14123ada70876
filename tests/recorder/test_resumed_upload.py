"""Copies of logs to S3 that were stopped, and go on: what is sent again, whose parts are taken, who wins."""

from __future__ import annotations

import os
import shutil
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from email.message import Message
from pathlib import Path
from typing import Final

import pytest

from bucket import Bucket, in_parts_of, serving_bucket, unfinished_parts
from common.errors import ObjectExistsError, StoreError
from common.store_connection import forget_stores
from driving import one_line_in
from faulty_proxy import Answer, Passing
from logs import write_log
from places import Handler
from recorder.log.copy_log import copy_log
from recorder.log_cli import main
from udacity import call

PARTS: Final = 6
URL: Final = "s3://logs/a.mcap"


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bucket]:
    folder = tmp_path_factory.mktemp("server")
    with pytest.MonkeyPatch.context() as patch, serving_bucket(folder, patch) as bucket:
        yield bucket


@pytest.fixture
def bucket(served: Bucket) -> Iterator[Bucket]:
    """An empty one."""
    for entry in served.folder.parent.iterdir():
        shutil.rmtree(entry)
    served.folder.mkdir()
    served.delay_s = 0
    served.pass_all()
    yield served
    forget_stores()  # what a test has set


@pytest.fixture
def log(bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A log that is sent in six parts; a.mcap."""
    path = write_log(tmp_path / "here/a.mcap", [0.1] * 60)
    in_parts_of(monkeypatch, -(-path.stat().st_size // PARTS))
    return path


def is_part(passing: Passing) -> bool:
    return passing.command == "PUT" and "partNumber" in passing.path


def sent_parts(bucket: Bucket) -> int:
    return sum(method == "PUT" and "partNumber" in path for method, path, _ in bucket.requests)


def from_part(first: int, fault: Answer) -> Answer:
    """Each part from this one on comes to nothing."""

    def answer(passing: Passing) -> bool:
        number = int(passing.path.partition("partNumber=")[2].partition("&")[0]) if is_part(passing) else 0
        return number >= first and fault(passing)

    return answer


def expired(passing: Passing) -> bool:
    return passing.fail(400, "ExpiredToken")


def stop_at_part(bucket: Bucket, log: Path, first: int) -> None:
    bucket.answer = from_part(first, expired)
    with pytest.raises(StoreError, match="ExpiredToken"):
        copy_log(log, bucket.url("a.mcap"))
    bucket.pass_all()


@pytest.mark.parametrize(
    ("tells_checksums", "wants_checksums"),
    [(True, True), (False, False), (False, True)],
    ids=["S3", "knows none", "SeaweedFS"],
)
def test_a_copy_that_was_stopped_goes_on_with_the_parts_that_are_there(
    bucket: Bucket, log: Path, tells_checksums: bool, wants_checksums: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Handler, "tells_checksums", tells_checksums)
    monkeypatch.setattr(Handler, "wants_checksums", wants_checksums)
    stop_at_part(bucket, log, 5)
    assert list(bucket.folder.iterdir()) == []
    copy_log(log, bucket.url("a.mcap"))
    assert sent_parts(bucket) == 2
    assert {path.name: path.read_bytes() for path in bucket.folder.iterdir()} == {"a.mcap": log.read_bytes()}
    assert unfinished_parts(bucket) == []


def test_ctrl_c_leaves_what_has_come_and_says_so(
    bucket: Bucket, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(passing: Passing) -> bool:
        os.kill(os.getpid(), signal.SIGINT)
        return passing.fail(400, "ExpiredToken")

    bucket.answer = from_part(PARTS, interrupt)
    assert call(main, "copy", log, URL) == 130
    assert f"`bc-log copy {log} {URL}` goes on with them" in " ".join(capsys.readouterr().err.split())
    bucket.pass_all()
    copy_log(log, bucket.url("a.mcap"))
    assert sent_parts(bucket) < PARTS
    assert (bucket.folder / "a.mcap").read_bytes() == log.read_bytes()


def test_another_logs_parts_are_not_taken_and_can_be_removed(
    bucket: Bucket, log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stop_at_part(bucket, log, 5)
    other = write_log(tmp_path / "other/a.mcap", [0.2] * 60)
    copy_log(other, bucket.url("a.mcap"))
    assert sent_parts(bucket) >= PARTS
    assert (bucket.folder / "a.mcap").read_bytes() == other.read_bytes()
    assert len(unfinished_parts(bucket)) == 4
    log.unlink()
    capsys.readouterr()
    assert call(main, "copy", log, "s3://logs", "--abort") == 0
    assert capsys.readouterr().out == f"{URL}: 1 unfinished upload removed\n"
    assert unfinished_parts(bucket) == []
    assert call(main, "copy", log, tmp_path / "there", "--abort") == 2


def test_an_upload_of_which_a_later_part_is_another_logs_is_not_gone_on_with(bucket: Bucket, log: Path) -> None:
    stop_at_part(bucket, log, 5)
    last = unfinished_parts(bucket)[-1]
    last.write_bytes(bytes(last.stat().st_size))
    copy_log(log, bucket.url("a.mcap"))
    assert sent_parts(bucket) == PARTS
    assert (bucket.folder / "a.mcap").read_bytes() == log.read_bytes()


@pytest.mark.parametrize("is_same_log", [True, False])
def test_two_machines_may_go_on_with_one_upload_at_once(
    bucket: Bucket, log: Path, tmp_path: Path, is_same_log: bool
) -> None:
    stop_at_part(bucket, log, 3)
    other = write_log(tmp_path / "other/a.mcap", [0.2] * 60)
    if is_same_log:
        shutil.copy(log, other)
    bucket.delay_s = 0.01
    with ThreadPoolExecutor() as machines:
        copies = [machines.submit(copy_log, each, bucket.url("a.mcap")) for each in (log, other)]
        failures = [copy.exception() for copy in copies]
    assert sum(isinstance(each, ObjectExistsError) for each in failures) == (0 if is_same_log else 1)
    winner = (log, other)[failures.index(None)]
    assert {path.name: path.read_bytes() for path in bucket.folder.iterdir()} == {"a.mcap": winner.read_bytes()}


def test_a_part_that_has_come_once_more_meanwhile_is_no_harm(bucket: Bucket, log: Path) -> None:
    invalid = iter([True])  # a store that encrypts gives the same bytes another ETag each time

    def once(passing: Passing) -> bool:
        is_end = passing.command == "POST" and "uploadId" in passing.path
        return is_end and next(invalid, False) and passing.fail(400, "InvalidPart")

    bucket.answer = once
    copy_log(log, bucket.url("a.mcap"))
    assert (bucket.folder / "a.mcap").read_bytes() == log.read_bytes()


def test_who_takes_the_name_meanwhile_wins_unless_it_may_be_replaced(bucket: Bucket, log: Path) -> None:
    def somebody(passing: Passing) -> bool:
        if passing.command == "POST" and "uploadId" in passing.path:
            (bucket.folder / "a.mcap").write_bytes(b"somebody else's")
        return False

    bucket.answer = somebody
    with pytest.raises(ObjectExistsError):
        copy_log(log, bucket.url("a.mcap"))
    assert (bucket.folder / "a.mcap").read_bytes() == b"somebody else's"
    assert unfinished_parts(bucket) == []
    copy_log(log, bucket.url("a.mcap"), overwrite=True)
    assert (bucket.folder / "a.mcap").read_bytes() == log.read_bytes()


@pytest.mark.parametrize(("status", "code"), [(403, "AccessDenied"), (501, "NotImplemented")])
def test_where_uploads_cannot_be_listed_logs_are_copied_all_the_same(
    bucket: Bucket, log: Path, status: int, code: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def unlisted(passing: Passing) -> bool:
        return passing.command == "GET" and "uploads" in passing.path and passing.fail(status, code)

    bucket.answer = lambda passing: unlisted(passing) or from_part(4, expired)(passing)
    assert call(main, "copy", log, URL) == 1
    assert "ExpiredToken" in one_line_in(capsys)  # and nothing of what stays
    assert unfinished_parts(bucket) == []
    bucket.answer = unlisted
    copy_log(log, bucket.url("a.mcap"))


def test_parts_are_sent_in_the_name_and_to_the_place_that_others_are(
    bucket: Bucket, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[str, Message]] = []

    def note(passing: Passing) -> bool:
        seen.append((passing.path, passing.headers))
        return False

    bucket.answer = note
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_REGION"):
        monkeypatch.delenv(name)
    endpoint = f"endpoint_url = {bucket.endpoint}\n"
    monkeypatch.delenv("AWS_ENDPOINT_URL_S3")
    (tmp_path / "credentials").write_text("[lab]\naws_access_key_id = LABKEY\naws_secret_access_key = secret\n")
    (tmp_path / "config").write_text(f"[profile lab]\nregion = eu-west-3\n{endpoint}")
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(tmp_path / "credentials"))
    monkeypatch.setenv("AWS_CONFIG_FILE", str(tmp_path / "config"))
    monkeypatch.setenv("AWS_PROFILE", "lab")
    monkeypatch.setenv("AWS_SERVER_SIDE_ENCRYPTION", "aws:kms")
    forget_stores()
    copy_log(log, bucket.url("a.mcap"))
    names = [headers["Authorization"] for _, headers in seen]
    assert all("Credential=LABKEY/" in name and "/eu-west-3/" in name for name in names)
    assert any("partNumber" in path for path, _ in seen)
    (begun,) = [headers for path, headers in seen if path.endswith("?uploads")]
    assert begun["x-amz-server-side-encryption"] == "aws:kms"
    seen.clear()
    monkeypatch.setenv("AWS_SKIP_SIGNATURE", "true")
    forget_stores()
    copy_log(log, bucket.url("b.mcap"))
    assert {headers["Authorization"] for path, headers in seen if "uploadId" in path} == {None}


def test_without_botocore_it_says_what_to_install(
    bucket: Bucket, log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "botocore.session", None)
    monkeypatch.delitem(sys.modules, "common.resumable_upload", raising=False)
    assert call(main, "copy", log, URL) == 1
    assert "pip install" in one_line_in(capsys)
