"""Logs in a store: read by range as those of a disk, copied whole, and every way in which a store fails."""

from __future__ import annotations

import json
import nturl2path
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import localbucket
import pytest

from common.errors import ObjectChangedError, StoreError, UsageError
from common.location import Url, location, relative_to
from recorder import Log, LogError
from recorder.log.tags import Tag, add_tags
from recorder.log_cli import main
from recorder.upkeep.check import check
from recorder.upkeep.copy_log import copy_log
from tests.helpers.bucket import Answer, Bucket
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import one_line_in
from tests.helpers.faulty_proxy import Passing
from tests.helpers.layouts import mixed
from tests.helpers.logs import flip_bit, write_log
from tests.helpers.long_log import lengthened
from tests.helpers.mcap_patch import patched
from tests.helpers.udacity import call, picture

ROWS = 40


@pytest.fixture
def log(bucket: Bucket) -> Path:
    """A log in the bucket, by its place on the server's disk; b.mcap."""
    return write_log(bucket.folder / "b.mcap", [0.01 * row for row in range(ROWS)], picture)


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """20 MB, nearly all of it pictures; large.mcap."""
    noise = bytes(range(256)) * 64
    path = tmp_path_factory.mktemp("large") / "large.mcap"
    return write_log(path, [0.0] * 400, lambda camera, row: f"{camera} {row}".encode() + noise)


def copied(log: Path, folder: Path) -> Path:
    return Path(shutil.copy(log, folder))


def tag(path: Path, name: str) -> None:
    with Log(path) as log:
        add_tags(path, log.fingerprint, [Tag(1, 2, name)])


# places


def test_a_place_is_a_path_or_a_url() -> None:
    assert location("sessions/a.mcap") == Path("sessions/a.mcap")
    assert location("file:///x/a%20b.mcap") == Path("/x/a b.mcap")
    url = location("s3://bucket//sessions/a.mcap/")
    assert url == Url("s3", "bucket", "sessions/a.mcap")
    assert (str(url), url.name, url.stem, url.suffix) == ("s3://bucket/sessions/a.mcap", "a.mcap", "a", ".mcap")
    assert str(url.parent / "b.mcap") == "s3://bucket/sessions/b.mcap"


def test_a_file_url_of_windows_is_a_path_with_its_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("urllib.request.url2pathname", nturl2path.url2pathname)
    assert str(location("file:///C:/x/a%20b.mcap")) == r"C:\x\a b.mcap"


@pytest.mark.parametrize(
    ("text", "meant"), [("s3:/x/a.mcap", "s3://x/a.mcap"), ("file:/a.mcap", "file:///a.mcap")]
)
def test_a_url_that_lacks_a_slash_is_reported_with_it(text: str, meant: str) -> None:
    with pytest.raises(UsageError, match=f"{text}: not a path; the URL is spelt {meant}"):
        location(text)


@pytest.mark.parametrize("text", ["http://x/a.mcap", "s3:///a.mcap", "ftp://x/y"])
def test_a_url_of_another_kind_is_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(main, "info", text) == 2
    assert text in capsys.readouterr().err


def test_a_place_is_named_relative_to_a_folder_that_can_be_moved_with_it(tmp_path: Path) -> None:
    assert relative_to(tmp_path / "sessions/a.mcap", tmp_path / "index") == "../sessions/a.mcap"
    in_store = Url("s3", "b", "data/sessions/a.mcap")
    assert relative_to(in_store, tmp_path) == str(in_store)


# reading


@pytest.mark.parametrize("layout", ["two kinds of chunks", "mixed", "unfinished"])
def test_rows_and_pictures_are_the_same_wherever_they_lie(bucket: Bucket, log: Path, layout: str) -> None:
    if layout == "mixed":
        log = mixed(log)
    elif layout == "unfinished":
        data = write_log(bucket.folder / "whole.mcap", [0.1] * 1500).read_bytes()
        log.write_bytes(data[: len(data) * 2 // 3])
    with Log(log) as local, Log(bucket.url(log.name)) as stored:
        assert local.fingerprint == stored.fingerprint
        assert local.problem == stored.problem
        assert local.vehicle().equals(stored.vehicle())
        assert local.frames().equals(stored.frames())
        last = local.vehicle()["row"].to_pylist()[-1]
        for row in (0, last, last // 2):
            assert local.picture(row, "left") == stored.picture(row, "left")


def test_the_end_of_a_log_is_all_that_info_moves(
    bucket: Bucket, large: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    size = copied(large, bucket.folder).stat().st_size
    bucket.requests.clear()
    assert call(main, "info", bucket.url("large.mcap")) == 0
    assert size > 19e6
    assert bucket.bytes_sent < 300_000
    assert bucket.count() <= 4  # its end, its start, and whether it has tags


@pytest.fixture(scope="module")
def longest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """8.4 GB, nearly all of it a hole, with an end of 3.4 MB."""
    folder = tmp_path_factory.mktemp("longest")
    return lengthened(write_log(folder / "short.mcap", [0.1] * 50), folder / "long.mcap", 32_000)


def put(log: Path, bucket: Bucket) -> Url:
    (bucket.folder / log.name).hardlink_to(log)
    localbucket.remember_etag(bucket.folder / log.name, "the server need not read all of it")
    return bucket.url(log.name)


def test_tags_of_a_long_log_are_reported_too(
    bucket: Bucket, longest: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    url = put(longest, bucket)
    with Log(url) as log:
        entry = {"add": "recovery", "rows": [1, 2], "log": log.fingerprint}
    (bucket.folder / "long.tags.jsonl").write_text(json.dumps(entry) + "\n")
    assert call(main, "info", url, "--json") == 0
    assert [each["name"] for each in json.loads(capsys.readouterr().out)["tags"]] == ["recovery"]


def test_a_log_that_lists_no_crcs_of_its_chunks_is_asked_for_those_alone(bucket: Bucket, large: Path) -> None:
    path = patched(copied(large, bucket.folder), lambda name, content: None)
    with Log(path) as log:
        expected = log.fingerprint
    bucket.requests.clear()
    with Log(bucket.url("large.mcap")) as log:
        assert len(log.chunks) > 70
        assert log.fingerprint == expected
    assert bucket.bytes_sent < 300_000


def test_ls_lists_a_folder_in_a_store(bucket: Bucket, log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (bucket.folder / "other.txt").write_text("no log")
    assert call(main, "ls", "s3://logs") == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["log", "b"]


def test_damage_in_a_store_is_found_and_named(bucket: Bucket, log: Path) -> None:
    with Log(log) as opened:
        picture_at = int(opened.pictures("/camera/center").offset[3])
    flip_bit(log, picture_at + 20)
    with (
        Log(bucket.url("b.mcap")) as opened,
        pytest.raises(LogError, match=r"does not match its CRC; `bc-log copy s3://logs/b"),
    ):
        opened.picture(3)
    assert [finding.kind for finding in check(bucket.url("b.mcap")).findings] == [
        finding.kind for finding in check(log).findings
    ]


@pytest.mark.parametrize("knows_conditions", [True, False])
def test_an_object_that_is_replaced_while_it_is_read_is_named(
    bucket: Bucket, large: Path, knows_conditions: bool
) -> None:
    path = copied(large, bucket.folder)
    with Log(bucket.url("large.mcap")) as log:
        log.picture(0)
        path.unlink()
        write_log(path, [0.5] * 300)
        if knows_conditions:
            bucket.answer = lambda passing: (
                "If-Match" in passing.headers and passing.fail(412, "PreconditionFailed")
            )
        with pytest.raises(ObjectChangedError, match=r"s3://logs/large.mcap: was replaced while it was read"):
            log.picture(200)
        bucket.pass_all()
        path.unlink()
        with pytest.raises(ObjectChangedError, match="removed"):
            log.picture(300)


# a store that fails


def refused(status: int, code: str) -> Answer:
    return lambda handler: bool(handler.fail(status, code))


@pytest.mark.parametrize(
    ("answer", "reported"),
    [
        (refused(403, "AccessDenied"), r"refuses this request with these credentials \(AccessDenied\)"),
        (refused(403, "RequestTimeTooSkewed"), "this machine's clock is wrong"),
        (refused(404, "NoSuchBucket"), "s3://logs: no such bucket"),
        (refused(301, "PermanentRedirect"), "another region: set AWS_REGION"),
        (refused(400, "AuthorizationHeaderMalformed"), "another region: set AWS_REGION"),
        (refused(501, "NotImplemented"), "does not support this request"),
        (refused(400, "ExpiredToken"), r"not valid \(ExpiredToken\): set AWS_ACCESS_KEY_ID"),
        (refused(403, "SignatureDoesNotMatch"), r"not valid \(SignatureDoesNotMatch\): set AWS_ACCESS_KEY_ID"),
        (refused(400, "InvalidRequest"), r"answers 400 Bad Request \(InvalidRequest\): as the test says"),
        (refused(503, "SlowDown"), "answers 503"),
    ],
)
def test_a_store_that_refuses_is_one_line(
    bucket: Bucket, answer: Answer, reported: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also where it is HEAD that is refused, which comes without a word of why."""
    bucket.answer = answer
    assert call(main, "info", "s3://logs/sessions.mcap") == 1
    assert re.search(reported, one_line_in(capsys))


def test_a_log_that_the_store_refuses_does_not_hold_up_the_others(
    bucket: Bucket, log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copyfile(log, log.with_name("a.mcap"))
    bucket.answer = lambda passing: "a.mcap" in passing.path and passing.fail(403, "AccessDenied")
    assert call(main, "copy", "s3://logs/a.mcap", f"s3://logs/{log.name}", tmp_path / "here") == 1
    assert "1 log of 2 not copied" in capsys.readouterr().err
    assert (tmp_path / "here" / log.name).read_bytes() == log.read_bytes()


def test_a_listing_and_a_copy_that_are_refused_are_one_line(
    bucket: Bucket, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bucket.answer = refused(403, "AccessDenied")
    for line in (["ls", "s3://logs/sessions"], ["copy", log, "s3://logs/sessions/a.mcap"]):
        assert call(main, *line) == 1
        assert "refuses this request with these credentials (AccessDenied)" in one_line_in(capsys)


@pytest.mark.parametrize(
    ("url", "reported"),
    [
        ("s3://logs", "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"),
        ("gs://logs", "GOOGLE_APPLICATION_CREDENTIALS"),
        ("az://logs", "AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY"),
    ],
)
def test_without_credentials_it_reports_which_to_set(
    bucket: Bucket, url: str, reported: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in list(os.environ):
        if name.startswith(("AWS_", "AZURE_", "GOOGLE_")):
            monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_CONFIG_FILE", os.devnull)
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", os.devnull)
    monkeypatch.setenv("GOOGLE_APPLICATION_CREDENTIALS", "/there/is/no/such.json")
    monkeypatch.setenv("AWS_METADATA_ENDPOINT", bucket.endpoint)
    bucket.answer = lambda passing: passing.fail(404, "NotFound")  # a machine that has no role
    assert call(main, "ls", url) == 1
    assert f"{url}: no usable credentials: set {reported}" in one_line_in(capsys)


def test_without_the_right_to_list_it_reports_so(
    bucket: Bucket, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def as_s3_does(passing: Passing) -> bool:
        is_there = (bucket.folder / Path(passing.path).name).is_file()
        return not is_there and passing.fail(403, "AccessDenied")

    bucket.answer = as_s3_does
    for verb, url in (("ls", "s3://logs/"), ("info", "s3://logs/b.mcap")):  # it may well have tags
        assert call(main, verb, url) == 1
        line = one_line_in(capsys)
        assert "s3://logs/" in line
        assert "s3:ListBucket" in line


def test_no_such_log_names_what_lists_those_there_are(bucket: Bucket, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(main, "info", "s3://logs/sessions/a.mcap") == 1
    assert "no such object" in (line := one_line_in(capsys))
    assert "bc-log ls s3://logs/sessions" in line


def test_a_store_that_is_not_there_is_said(
    bucket: Bucket, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL_S3", "http://127.0.0.1:1")
    assert call(main, "ls", "s3://logs") == 1
    assert "cannot be reached (endpoint http://127.0.0.1:1)" in one_line_in(capsys)


@pytest.mark.parametrize(
    ("place", "name", "value"),
    [
        ("s3://logs", "AWS_ENDPOINT_URL_S3", "127.0.0.1:9000"),
        ("s3://logs", "AWS_ENDPOINT_URL_S3", "http://127.0.0.1:99999"),
        ("s3://logs", "AWS_ENDPOINT_URL_S3", "http://127.0.0.1:x"),
        ("s3://logs", "AWS_ENDPOINT_URL_S3", "http://a b:9000"),
        ("s3://logs", "AWS_ENDPOINT_URL", "http://"),
        ("s3://logs", "AWS_REGION", "us east"),
        ("s3://logs", "AWS_ACCESS_KEY_ID", "key\n"),
        ("gs://logs", "GOOGLE_BASE_URL", "127.0.0.1:9000"),
        ("az://logs", "AZURE_STORAGE_ENDPOINT", "127.0.0.1:9000"),
    ],
)
def test_a_setting_that_no_store_can_be_reached_with_is_named(
    bucket: Bucket,
    place: str,
    name: str,
    value: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if name != "AWS_ENDPOINT_URL_S3":
        monkeypatch.delenv("AWS_ENDPOINT_URL_S3")
    monkeypatch.setenv(name, value)
    assert call(main, "ls", place) == 1
    assert one_line_in(capsys).startswith(f"bc-log: {name}")


def test_an_endpoint_in_the_usual_file_is_checked_too(
    bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("AWS_ENDPOINT_URL_S3")
    (tmp_path / "config").write_text("[default]\nendpoint_url = 127.0.0.1:9000\n")
    monkeypatch.setenv("AWS_CONFIG_FILE", str(tmp_path / "config"))
    assert call(main, "ls", "s3://logs") == 1
    assert "endpoint=127.0.0.1:9000: not an endpoint" in one_line_in(capsys)


def test_credentials_are_those_of_the_usual_files(
    bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seen: list[str] = []

    def note(handler: Any) -> bool:
        seen.append(handler.headers["Authorization"])
        return False

    bucket.answer = note
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    monkeypatch.delenv("AWS_REGION")
    (tmp_path / "credentials").write_text("[lab]\naws_access_key_id = LABKEY\naws_secret_access_key = secret\n")
    (tmp_path / "config").write_text("[profile lab]\nregion = eu-west-3\n")
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(tmp_path / "credentials"))
    monkeypatch.setenv("AWS_CONFIG_FILE", str(tmp_path / "config"))
    monkeypatch.setenv("AWS_PROFILE", "lab")
    call(main, "ls", "s3://logs")
    assert all("Credential=LABKEY/" in each and "/eu-west-3/" in each for each in seen)
    assert seen


def test_without_obstore_a_url_reports_what_to_install(tmp_path: Path) -> None:
    code = "import sys; sys.modules['obstore'] = None; from recorder.log_cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code, "info", "s3://b/a.mcap"], capture_output=True, text=True)
    assert done.returncode == 1
    assert "pip install" in done.stderr
    assert done.stderr.count("\n") == 1


# copying


def test_a_log_its_tags_and_its_lag_go_to_a_store_and_back(
    bucket: Bucket, large: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = copied(large, tmp_path)
    tag(log, "recovery")
    beside = tmp_path / "large.tags.jsonl", tmp_path / "large.lag.json"
    beside[1].write_text("{}")
    assert call(main, "copy", log, "s3://logs/sessions") == 0
    assert capsys.readouterr().out == f"s3://logs/sessions/large.mcap: {log.stat().st_size / 1e6:,.1f} MB\n"
    files = {path.name: path.read_bytes() for path in (bucket.folder / "sessions").iterdir()}
    assert files == {path.name: path.read_bytes() for path in (log, *beside)}
    assert call(main, "copy", "s3://logs/sessions", tmp_path / "back") == 0
    assert {path.name: path.read_bytes() for path in (tmp_path / "back").iterdir()} == files


def test_what_is_there_already_is_left_alone(
    bucket: Bucket, large: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = copied(large, tmp_path)
    assert call(main, "copy", log, "s3://logs") == 0
    bucket.requests.clear()
    assert call(main, "copy", log, "s3://logs") == 0
    assert "was there already" in capsys.readouterr().out
    assert bucket.count("PUT") == bucket.count("POST") == 0
    assert call(main, "copy", "s3://logs/large.mcap", tmp_path) == 0
    assert "was there already" in capsys.readouterr().out
    assert bucket.bytes_sent < 1e6


@pytest.mark.parametrize("is_upload", [True, False])
def test_nothing_is_replaced_unasked(
    bucket: Bucket, tmp_path: Path, is_upload: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    ours = write_log(tmp_path / "a.mcap", [0.1] * 5)
    theirs = write_log(bucket.folder / "a.mcap", [0.2] * 5)
    places = (ours, bucket.url()) if is_upload else (bucket.url("a.mcap"), tmp_path)
    before = (ours.read_bytes(), theirs.read_bytes())
    assert call(main, "copy", *places) == 1
    assert "--force" in one_line_in(capsys)
    assert (ours.read_bytes(), theirs.read_bytes()) == before
    assert call(main, "copy", *places, "--force") == 0
    assert ours.read_bytes() == theirs.read_bytes() == before[not is_upload]


def test_a_download_that_was_stopped_goes_on_where_it_was(
    bucket: Bucket, large: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = copied(large, bucket.folder)

    def end_early(handler: Any) -> bool:
        begin = (handler.headers["Range"] or "bytes=0-").removeprefix("bytes=").partition("-")[0]
        return bool(handler.fail(403, "ExpiredToken")) if int(begin or 0) >= 16 << 20 else False

    bucket.answer = end_early
    assert call(main, "copy", "s3://logs/large.mcap", tmp_path / "here") == 1
    (part,) = (tmp_path / "here").iterdir()
    assert part.stat().st_size == 16 << 20
    capsys.readouterr()
    bucket.answer = lambda handler: False
    bucket.requests.clear()
    assert call(main, "copy", "s3://logs/large.mcap", tmp_path / "here") == 0
    assert bucket.bytes_sent < 5 << 20
    assert {path.name: path.read_bytes() for path in (tmp_path / "here").iterdir()} == {
        "large.mcap": log.read_bytes()
    }


def test_a_download_to_a_full_disk_names_it_and_goes_on(
    bucket: Bucket, large: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = copied(large, bucket.folder)
    with files_of_at_most(16 << 20):
        assert call(main, "copy", "s3://logs/large.mcap", tmp_path / "here") == 1
    line = one_line_in(capsys)
    assert f"{tmp_path}/here/large.mcap: " in line
    assert "the same command continues" in line
    bucket.requests.clear()
    assert call(main, "copy", "s3://logs/large.mcap", tmp_path / "here") == 0
    assert bucket.bytes_sent < 14 << 20
    assert (tmp_path / "here/large.mcap").read_bytes() == log.read_bytes()


def test_nothing_is_kept_of_a_download_whose_object_is_replaced(
    bucket: Bucket, large: Path, tmp_path: Path
) -> None:
    copied(large, bucket.folder)

    def replace(passing: Passing) -> bool:
        first = (passing.headers["Range"] or "bytes=0-").removeprefix("bytes=").partition("-")[0]
        if first == str(8 << 20):
            write_log(tmp_path / "new.mcap", [0.2] * 3).replace(bucket.folder / "large.mcap")
        return False

    bucket.answer = replace
    with pytest.raises(ObjectChangedError):
        copy_log(bucket.url("large.mcap"), tmp_path / "here/large.mcap")
    assert list((tmp_path / "here").iterdir()) == []


@pytest.mark.parametrize("is_upload", [True, False])
def test_what_is_not_whole_is_not_copied(
    bucket: Bucket, tmp_path: Path, is_upload: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path if is_upload else bucket.folder
    log = write_log(source / "a.mcap", [0.1] * 50, picture)
    flip_bit(log, log.stat().st_size // 2)
    places = (log, bucket.url()) if is_upload else (bucket.url("a.mcap"), tmp_path / "here")
    assert call(main, "copy", *places) == 1
    assert "damaged" in one_line_in(capsys)
    assert len(list(bucket.folder.iterdir())) == (0 if is_upload else 1)
    if not is_upload:
        (part,) = (tmp_path / "here").iterdir()
        assert call(main, "recover", part) == 3
        assert (tmp_path / "here/a.mcap").is_file()


def test_other_tags_than_ours_stay(bucket: Bucket, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_log(tmp_path / "a.mcap", [0.1] * 5)
    tag(log, "mine")
    (bucket.folder / "a.tags.jsonl").write_text("theirs")
    assert call(main, "copy", log, "s3://logs") == 3
    assert "a.tags.jsonl: not copied" in capsys.readouterr().err
    assert (bucket.folder / "a.tags.jsonl").read_text() == "theirs"


def test_copies_are_between_this_machine_and_a_store(tmp_path: Path, bucket: Bucket, log: Path) -> None:
    assert call(main, "copy", log, tmp_path / "x") == 1
    assert call(main, "copy", "s3://logs/b.mcap", "s3://logs/x") == 1
    assert call(main, "copy", log) == 2
    assert call(main, "copy", log, log, "s3://logs/x.mcap") == 2


# what is done on this machine only


@pytest.mark.parametrize("command", ["trim", "merge", "rewrite", "recover", "split", "tag"])
def test_logs_are_made_and_tagged_on_this_machine(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    to = () if command == "tag" else ("--to", "new.mcap")
    assert call(main, command, "s3://logs/b.mcap", *to) == 1
    assert "s3://logs/b.mcap is in a store; bring it here first: `bc-copy s3://logs/b.mcap FOLDER`" in one_line_in(
        capsys
    )


def test_errors_of_a_store_are_errors_of_their_own() -> None:
    assert not issubclass(
        StoreError, LogError
    )  # what cannot be reached is not damaged: nothing is left out for it
