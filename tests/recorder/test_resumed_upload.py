"""Copies of logs to S3 and Azure that were stopped, and go on: what is sent again, whose parts count, who wins.

Azure is Azurite (`make azurite`), and long.
"""

from __future__ import annotations

import base64
import os
import re
import secrets
import shutil
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import timedelta
from email.message import Message
from pathlib import Path
from typing import Final
from urllib.parse import unquote

import obstore
import pytest
import urllib3

from bucket import Bucket, in_parts_of, serving_bucket, unfinished_parts
from common.errors import ObjectExistsError, StoreError
from common.location import Url
from common.object_store import list_below, put_over, read_object
from common.store_connection import forget_stores, store_of
from driving import one_line_in
from emulators import way_to_azurite
from faulty_proxy import Answer, FaultyProxy, Passing
from logs import write_log
from places import Handler
from recorder.log_cli import main
from recorder.upkeep.copy_log import copy_log
from udacity import call

PARTS: Final = 6
URL: Final = "s3://logs/a.mcap"
AZURE: Final = pytest.param("Azure", marks=pytest.mark.long)


@dataclass
class Store:
    """A place for a.mcap, in a store that keeps the parts of uploads; how it fails."""

    url: Url
    way: FaultyProxy
    part: re.Pattern[str]  # a request that sends one, with its number, or name
    end: re.Pattern[str]  # one that makes an object of them

    def number(self, passing: Passing) -> int:
        """Of the part that a request sends; 0 if it is none."""
        found = self.part.match(f"{passing.command} {passing.path}")
        if found is None:
            return 0
        return (
            int(found[1])
            if found[1].isdecimal()
            else int.from_bytes(base64.b64decode(unquote(found[1]))[:4], "big")
        )

    def is_end(self, passing: Passing) -> bool:
        return self.end.match(f"{passing.command} {passing.path}") is not None

    def sent_parts(self) -> int:
        return sum(self.part.match(f"{method} {path}") is not None for method, path, _ in self.way.requests)

    def contents(self) -> dict[str, bytes | None]:
        return {each.url.name: read_object(each.url, 1 << 30) for each in list_below(self.url.parent)}

    def from_part(self, first: int, fault: Answer) -> None:
        """Let each part from this one on come to nothing."""
        self.way.answer = lambda passing: self.number(passing) >= first and fault(passing)

    def stop_at_part(self, log: Path, first: int) -> None:
        self.from_part(first, expired)
        with pytest.raises(StoreError, match="ExpiredToken"):
            copy_log(log, self.url)
        self.way.pass_all()


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


@pytest.fixture(scope="module")
def azure() -> Iterator[FaultyProxy]:
    """The way to a container `logs`."""
    with way_to_azurite("logs") as way:
        yield way


@pytest.fixture(params=["S3", AZURE])
def store(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Store]:
    """An empty place in a store of each kind."""
    if request.param == "Azure":
        way: FaultyProxy = request.getfixturevalue("azure")
        way.delay_s = 0
        way.pass_all()
        url = Url("az", "logs", f"{secrets.token_hex(4)}/a.mcap")  # blocks of another test stay
        yield Store(url, way, re.compile(r"PUT .*&comp=block&blockid=(.*)"), re.compile("PUT .*&comp=blocklist"))
        return
    monkeypatch.setattr(Handler, "tells_checksums", request.param == "S3")
    monkeypatch.setattr(Handler, "wants_checksums", request.param != "S3 without checksums")
    bucket: Bucket = request.getfixturevalue("bucket")
    yield s3(bucket)


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A log that is sent in six parts; a.mcap."""
    path = write_log(tmp_path / "here/a.mcap", [0.1] * 60)
    in_parts_of(monkeypatch, -(-path.stat().st_size // PARTS))
    return path


def expired(passing: Passing) -> bool:
    return passing.fail(400, "ExpiredToken")


def s3(bucket: Bucket) -> Store:
    return Store(
        bucket.url("a.mcap"), bucket, re.compile(r"PUT .*partNumber=(\d+)"), re.compile("POST .*uploadId")
    )


@pytest.mark.parametrize("store", ["S3", "S3 without checksums", "SeaweedFS", AZURE], indirect=True)
def test_a_copy_that_was_stopped_goes_on_with_the_parts_that_are_there(store: Store, log: Path) -> None:
    store.stop_at_part(log, 5)
    assert store.contents() == {}
    copy_log(log, store.url)
    assert store.sent_parts() == 2
    assert store.contents() == {"a.mcap": log.read_bytes()}


def test_ctrl_c_leaves_what_has_come_and_says_so(
    store: Store, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(passing: Passing) -> bool:
        os.kill(os.getpid(), signal.SIGINT)
        return passing.fail(400, "ExpiredToken")

    store.from_part(PARTS, interrupt)
    assert call(main, "copy", log, store.url) == 130
    assert f"`bc-log copy {log} {store.url}` goes on with them" in " ".join(capsys.readouterr().err.split())
    store.way.pass_all()
    copy_log(log, store.url)
    assert store.sent_parts() < PARTS
    assert store.contents() == {"a.mcap": log.read_bytes()}


def test_another_logs_parts_are_not_taken(store: Store, log: Path, tmp_path: Path) -> None:
    store.stop_at_part(log, 5)
    other = write_log(tmp_path / "other/a.mcap", [0.2] * 60)
    copy_log(other, store.url)
    assert store.contents() == {"a.mcap": other.read_bytes()}


def test_what_an_upload_has_left_in_s3_can_be_removed(
    bucket: Bucket, log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    s3(bucket).stop_at_part(log, 5)
    copy_log(write_log(tmp_path / "other/a.mcap", [0.2] * 60), bucket.url("a.mcap"))
    assert len(unfinished_parts(bucket)) == 4
    log.unlink()
    capsys.readouterr()
    assert call(main, "copy", log, "s3://logs", "--abort") == 0
    assert capsys.readouterr().out == f"{URL}: 1 unfinished upload removed\n"
    assert unfinished_parts(bucket) == []
    assert call(main, "copy", log, tmp_path / "there", "--abort") == 2


def test_an_upload_with_a_part_of_another_log_is_not_resumed(bucket: Bucket, log: Path) -> None:
    s3(bucket).stop_at_part(log, 5)
    last = unfinished_parts(bucket)[-1]
    last.write_bytes(bytes(last.stat().st_size))
    copy_log(log, bucket.url("a.mcap"))
    assert s3(bucket).sent_parts() == PARTS
    assert (bucket.folder / "a.mcap").read_bytes() == log.read_bytes()


@pytest.mark.parametrize("is_same_log", [True, False])
def test_two_machines_may_go_on_with_one_upload_at_once(
    store: Store, log: Path, tmp_path: Path, is_same_log: bool
) -> None:
    store.stop_at_part(log, 3)
    other = write_log(tmp_path / "other/a.mcap", [0.2] * 60)
    if is_same_log:
        shutil.copy(log, other)
    store.way.delay_s = 0.01
    with ThreadPoolExecutor() as machines:
        copies = [machines.submit(copy_log, each, store.url) for each in (log, other)]
        failures = [copy.exception() for copy in copies]
    assert sum(isinstance(each, ObjectExistsError) for each in failures) == (0 if is_same_log else 1)
    winner = (log, other)[failures.index(None)]
    assert store.contents() == {"a.mcap": winner.read_bytes()}


def test_a_part_that_has_come_once_more_meanwhile_is_no_harm(bucket: Bucket, log: Path) -> None:
    invalid = iter([True])  # a store that encrypts gives the same bytes another ETag each time

    def once(passing: Passing) -> bool:
        is_end = passing.command == "POST" and "uploadId" in passing.path
        return is_end and next(invalid, False) and passing.fail(400, "InvalidPart")

    bucket.answer = once
    copy_log(log, bucket.url("a.mcap"))
    assert (bucket.folder / "a.mcap").read_bytes() == log.read_bytes()


def test_who_takes_the_name_meanwhile_wins_unless_it_may_be_replaced(store: Store, log: Path) -> None:
    def somebody(passing: Passing) -> bool:
        if store.is_end(passing):
            put_over(store.url, b"somebody else's")
        return False

    store.way.answer = somebody
    with pytest.raises(ObjectExistsError):
        copy_log(log, store.url)
    assert store.contents() == {"a.mcap": b"somebody else's"}
    copy_log(log, store.url, overwrite=True)
    assert store.contents() == {"a.mcap": log.read_bytes()}


@pytest.mark.long
@pytest.mark.parametrize("store", ["Azure"], indirect=True)
def test_blocks_get_to_azure_over_a_bad_connection(store: Store, log: Path) -> None:
    store.way.fail_each_once()
    copy_log(log, store.url)
    assert store.contents() == {"a.mcap": log.read_bytes()}


@pytest.mark.long
@pytest.mark.parametrize("store", ["Azure"], indirect=True)
def test_blocks_of_another_program_are_named(store: Store, log: Path) -> None:
    link = obstore.sign(store_of(store.url, True), "PUT", store.url.key, timedelta(hours=1))  # type: ignore[call-overload]
    assert urllib3.request("PUT", f"{link}&comp=block&blockid=c2hvcnQ=", body=b"another program's").status == 201
    with pytest.raises(StoreError, match="another program is sending something of that name"):
        copy_log(log, store.url)


@pytest.mark.long
@pytest.mark.parametrize("store", ["Azure"], indirect=True)
def test_where_azure_takes_no_signature_logs_are_copied_all_the_same(store: Store, log: Path) -> None:
    name = "a name that obstore signs otherwise than Azure.mcap"
    copy_log(log, store.url.with_name(name))
    assert store.contents() == {name: log.read_bytes()}


@pytest.mark.parametrize(("status", "code"), [(403, "AccessDenied"), (501, "NotImplemented")])
def test_where_uploads_cannot_be_listed_logs_are_copied_all_the_same(
    bucket: Bucket, log: Path, status: int, code: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def unlisted(passing: Passing) -> bool:
        return passing.command == "GET" and "uploads" in passing.path and passing.fail(status, code)

    bucket.answer = lambda passing: unlisted(passing) or (s3(bucket).number(passing) >= 4 and expired(passing))
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
