"""`bc-log rewrite` brings a log of an earlier version into the present layout, and it stays the same log."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from mcap.writer import CompressionType

from dataset import IndexConfig, Samples, build_index
from recorder import Log, LogError
from recorder.log.tags import Tag, add_tags
from recorder.log_cli import main
from recorder.upkeep.check import check
from recorder.upkeep.edit import rewrite
from recorder.upkeep.recover import recover
from tests.helpers.driving import one_line_in
from tests.helpers.layouts import write_as_before
from tests.helpers.logs import flip_bit, tags_of, write_log
from tests.helpers.plain_mcap import contents, write_plain
from tests.helpers.udacity import call, jpeg

STEERING = [round(0.02 * (row % 40) - 0.4, 2) for row in range(120)]
CONFIG = IndexConfig(block_s=1.0, gap_s=0.2)


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("old")
    new = write_log(folder / "new.mcap", STEERING, lambda camera, row: jpeg(len(camera), row))
    return write_as_before(new, folder / "old.mcap", chunk_bytes=20_000)


@pytest.fixture
def old(tmp_path: Path, original: Path) -> Path:
    """A log as earlier versions wrote it, with a tag."""
    path = Path(shutil.copy(original, tmp_path))
    with Log(path) as log:
        add_tags(path, log.fingerprint, [Tag(10, 20, "exclude")])
    return path


def fingerprints(path: Path) -> tuple[str, str]:
    with Log(path) as log:
        return log.fingerprint, log.file_fingerprint


def test_messages_rows_times_metadata_and_tags_are_the_same(old: Path, tmp_path: Path) -> None:
    done = rewrite(old, tmp_path / "new.mcap")
    before, after = contents(old), contents(done.path)
    assert sorted(after.messages) == sorted(before.messages)
    for topic in {message.topic for message in before.messages}:
        assert after.of(topic) == before.of(topic)
    assert (done.messages, done.rows) == (len(before.messages), len(STEERING))
    session = dict(after.metadata)["bc.session"]
    assert session["rewritten_from"] == "old.mcap"
    assert session.items() >= dict(before.metadata)["bc.session"].items()
    assert tags_of(done.path) == [(10, 20, "exclude")]
    assert check(done.path).findings == []


def test_it_and_its_rewrites_have_the_fingerprint_of_the_original(old: Path, tmp_path: Path) -> None:
    first = rewrite(old, tmp_path / "1.mcap").path
    second = rewrite(first, tmp_path / "2.mcap").path
    assert fingerprints(first)[0] == fingerprints(second)[0] == fingerprints(old)[0]
    assert fingerprints(first)[1] != fingerprints(old)[1]


@pytest.mark.parametrize("where", ["its end", "a picture"])
def test_tags_come_along_when_it_is_damaged_and_recovered(old: Path, tmp_path: Path, where: str) -> None:
    new = rewrite(old, tmp_path / "new.mcap").path
    flip_bit(new, -20 if where == "its end" else contents(new).chunks[0].end - 20)
    to = recover(new, tmp_path / "recovered.mcap").path
    assert tags_of(to) == [(10, 20, "exclude")]


def test_an_index_is_built_anew_and_holds_the_same_samples(old: Path, tmp_path: Path) -> None:
    session = Path(shutil.copy(old, tmp_path / "session.mcap"))
    build_index([session], tmp_path / "index", CONFIG)
    with Samples(tmp_path / "index") as samples:
        before, content = samples.table.to_pylist(), samples.content_fingerprint
        kept = samples.fingerprint
    new = rewrite(session, tmp_path / "new.mcap").path
    new.replace(session)
    with pytest.raises(Exception, match="has changed since it was indexed"):
        Samples(tmp_path / "index")  # its pictures have other places
    assert build_index([session], tmp_path / "index", CONFIG).read == ["session"]
    assert build_index([session], tmp_path / "index", CONFIG).read == []
    with Samples(tmp_path / "index") as samples:
        places = ("offset", "chunk")
        after = samples.table.to_pylist()
        assert samples.content_fingerprint == content
        assert samples.fingerprint != kept
        assert [{k: v for k, v in row.items() if k not in places} for row in after] == [
            {k: v for k, v in row.items() if k not in places} for row in before
        ]


@pytest.mark.parametrize("kind", ["killed", "another program's"])
def test_what_cannot_be_rewritten_reports_what_to_do(old: Path, tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.mcap"
    if kind == "killed":
        path.write_bytes(old.read_bytes()[:-100_000])
    else:
        write_plain(path, CompressionType.NONE, range(5))
    with pytest.raises(LogError, match="bc-log recover" if kind == "killed" else "bc-import .* NAME"):
        rewrite(path, tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()


def test_nothing_is_overwritten_and_a_damaged_log_leaves_nothing(
    old: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(main, "rewrite", old, "--to", tmp_path / "new.mcap") == 0
    assert "you can replace it" in capsys.readouterr().err
    assert call(main, "rewrite", old, "--to", tmp_path / "new.mcap") == 1
    assert "--force" in one_line_in(capsys)
    flip_bit(old, contents(old).chunks[3].start + 200)
    with pytest.raises(LogError, match="bc-log recover"):
        rewrite(old, tmp_path / "damaged.mcap")
    assert not list(tmp_path.glob("damaged*"))


def test_it_reports_the_sizes_of_its_pictures(old: Path, tmp_path: Path) -> None:
    quality = dict(contents(rewrite(old, tmp_path / "new.mcap").path).metadata)["bc.quality"]
    assert set(json.loads(quality["first_picture_px"])) == {"/camera/center", "/camera/left", "/camera/right"}
