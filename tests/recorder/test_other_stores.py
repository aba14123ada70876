"""Logs in stores of other kinds than S3: read, indexed and trained on as from a disk; in Azure's, written, too."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from common.errors import ObjectChangedError, ObjectExistsError
from common.folder_copy import FolderUpload, download_folder
from common.location import Url
from common.object_store import list_objects
from common.store_connection import forget_stores
from dataset import IndexConfig, build_index, load
from recorder import Log
from recorder.log.tags import Tag, add_tags, read_tags
from recorder.log_cli import main
from recorder.upkeep.check import check
from recorder.upkeep.copy_log import copy_log
from tests.helpers.driving import one_line_in
from tests.helpers.emulators import ACCOUNT_KEY, put_in_gcs, serving_gcs, serving_googles_xml, way_to_azurite
from tests.helpers.faulty_proxy import FaultyProxy, Passing
from tests.helpers.logs import write_log
from tests.helpers.udacity import call, jpeg

TAG = Tag(1, 2, "exclude")


@dataclass
class Store:
    """The bucket `logs` of a store."""

    scheme: str
    put: Callable[[Path, str], object]  # a file of this machine, its name there; over what has it
    way: FaultyProxy

    def url(self, key: str = "") -> Url:
        return Url(self.scheme, "logs", key)


@pytest.fixture(scope="module")
def azure() -> Iterator[Store]:
    with way_to_azurite("logs") as way:
        yield Store("az", lambda path, name: copy_log(path, Url("az", "logs", name), overwrite=True), way)


@pytest.fixture(scope="module")
def gcs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Store]:
    with pytest.MonkeyPatch.context() as patch, serving_gcs("logs") as port:
        way = FaultyProxy()
        with way.before(port):
            patch.setenv("GOOGLE_BASE_URL", way.endpoint)
            patch.setenv("GOOGLE_SKIP_SIGNATURE", "true")
            forget_stores()
            yield Store("gs", lambda path, name: put_in_gcs(port, "logs", name, path), way)
            forget_stores()


@pytest.fixture(params=[pytest.param("azure", marks=pytest.mark.long), "gcs"])
def store(request: pytest.FixtureRequest) -> Iterator[Store]:
    chosen: Store = request.getfixturevalue(request.param)
    yield chosen
    chosen.way.pass_all()


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log of 60 rows with a tag; a.mcap."""
    path = write_log(tmp_path / "a.mcap", [row / 100 - 0.3 for row in range(60)], lambda _, row: jpeg(50 + row))
    with Log(path) as opened:
        add_tags(path, opened.fingerprint, [TAG])
    return path


def test_what_is_there_is_what_is_on_the_disk_also_over_a_bad_connection(store: Store, log: Path) -> None:
    url = store.url("x/a.mcap")
    store.put(log, "x/a.mcap")
    if store.scheme == "gs":
        store.put(log.with_name("a.tags.jsonl"), "x/a.tags.jsonl")
    store.way.fail_each_once()
    with Log(url) as stored, Log(log) as local:
        assert stored.problem == ""
        assert stored.frames().equals(local.frames())
        assert read_tags(url, stored.fingerprint) == [TAG]
    assert check(url).findings == []
    copy_log(url, log.parent / "back/a.mcap")
    assert (log.parent / "back/a.mcap").read_bytes() == log.read_bytes()
    assert (log.parent / "back/a.tags.jsonl").read_bytes() == (log.parent / "a.tags.jsonl").read_bytes()


@pytest.mark.long
def test_an_index_and_its_pictures_are_those_of_the_disk(
    store: Store, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    log.with_name("a.tags.jsonl").unlink()
    store.put(log, "y/a.mcap")
    settings = IndexConfig(labels="as-recorded", block_s=1, gap_s=0)
    epochs = []
    for name, place in (("here", log), ("there", store.url("y/a.mcap"))):
        assert build_index([place], tmp_path / name, settings).read == ["a"]
        assert build_index([place], tmp_path / name, settings).read == []
        with load(tmp_path / name, batch=16) as loader:
            epochs.append([(batch.pictures.tobytes(), batch.steering.tobytes()) for batch in loader.epoch(1)])
    assert epochs[0] == epochs[1]


def test_what_is_replaced_while_it_is_read_is_named(store: Store, log: Path, tmp_path: Path) -> None:
    large = write_log(tmp_path / "large.mcap", [0.1] * 300, lambda camera, row: bytes([row % 256]) * 9000)
    store.put(large, "z/a.mcap")
    with Log(store.url("z/a.mcap")) as opened:
        opened.picture(0)
        store.put(log, "z/a.mcap")
        with pytest.raises(ObjectChangedError, match=f"{store.scheme}://logs/z/a.mcap: was replaced"):
            opened.picture(200)


def test_what_is_not_there_is_one_line(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(main, "info", store.url("none/a.mcap")) == 1
    assert f"{store.scheme}://logs/none/a.mcap: no such object; `bc-log ls" in one_line_in(capsys)


def test_a_log_goes_to_google_whole_and_over_nothing(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "server/logs").mkdir(parents=True)
    url = Url("gs", "logs", "new/a.mcap")
    way = FaultyProxy()
    with serving_googles_xml(tmp_path / "server") as port, way.before(port):
        account = {"gcs_base_url": way.endpoint, "disable_oauth": True, "client_email": "", "private_key": ""}
        (tmp_path / "key.json").write_text(json.dumps({**account, "private_key_id": ""}))
        for name in ("GOOGLE_BASE_URL", "GOOGLE_SKIP_SIGNATURE"):  # of the emulator that is only read
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setenv("GOOGLE_SERVICE_ACCOUNT", str(tmp_path / "key.json"))
        forget_stores()
        way.fail_each_once()
        assert copy_log(log, url).is_new
        way.pass_all()
        assert not copy_log(log, url).is_new
        with pytest.raises(ObjectExistsError):
            copy_log(write_log(tmp_path / "other/a.mcap", [0.2] * 5), url)
    forget_stores()
    names = ("a.mcap", "a.tags.jsonl")
    folder = tmp_path / "server/logs/new"
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {
        name: log.with_name(name).read_bytes() for name in names
    }


@pytest.mark.long
def test_a_log_goes_to_azure_whole_and_over_nothing(azure: Store, log: Path, tmp_path: Path) -> None:
    azure.way.fail_each_once()
    assert copy_log(log, azure.url("new/a.mcap")).is_new
    azure.way.pass_all()
    assert [listed.url.name for listed in list_objects(azure.url("new"))] == ["a.mcap", "a.tags.jsonl"]
    assert not copy_log(log, azure.url("new/a.mcap")).is_new
    other = write_log(tmp_path / "other/a.mcap", [0.2] * 5)
    with pytest.raises(ObjectExistsError):
        copy_log(other, azure.url("new/a.mcap"))
    with Log(azure.url("new/a.mcap")) as stored, Log(log) as local:
        assert stored.file_fingerprint == local.file_fingerprint


@pytest.mark.long
def test_a_folder_goes_to_azure_and_back_whatever_answers_are_lost(azure: Store, tmp_path: Path) -> None:
    upload = FolderUpload(tmp_path / "one", azure.url("run"))
    (tmp_path / "one").mkdir()
    for content in ("first", "second"):
        (tmp_path / "one/config.json").write_text(content)
        azure.way.fail_first("PUT", Passing.lose)
        assert upload.copy()
        assert download_folder(azure.url("run"), tmp_path / content)
        assert (tmp_path / content / "config.json").read_text() == content


@pytest.mark.long
@pytest.mark.parametrize(
    ("url", "key", "reported"),
    [
        ("az://nowhere", ACCOUNT_KEY, "az://nowhere: no such bucket"),
        ("az://logs", "d3Jvbmc=", "the store refuses this request with these credentials (AuthorizationFailure)"),
        ("az://logs", "no base64", "no usable credentials: set AZURE_STORAGE_ACCOUNT_NAME"),
    ],
)
def test_what_azure_refuses_is_one_line(
    azure: Store,
    url: str,
    key: str,
    reported: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("AZURE_STORAGE_ACCOUNT_KEY", key)
    forget_stores()
    try:
        assert call(main, "ls", url) == 1
    finally:
        forget_stores()
    assert reported in one_line_in(capsys)
