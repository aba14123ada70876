"""An index that was built once stays right: whatever changes, moves, lies, or happens at the same time."""

from __future__ import annotations

import contextlib
import json
import os
import sys
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dataset import DatasetError, IndexConfig, Samples, build_index, find_logs
from dataset.cli import main
from dataset.config import IndexConfig as Config
from dataset.frames.frames_table import frames_table
from recorder import Log, LogError
from recorder.log.tags import Tag, add_tags
from tests.helpers.driving import Process
from tests.helpers.logs import write_log, write_session
from tests.helpers.udacity import call

STEERING = [round(0.02 * (row % 40) - 0.4, 2) for row in range(300)]  # 30 s
KEY = b"bc.index"


def rewrite(path: Path, table: pa.Table | None = None, **changed: Any) -> None:
    """Somebody's parquet file: other columns, or other metadata."""
    old = pq.read_table(path)
    metadata = {**json.loads(old.schema.metadata[KEY]), **changed}
    pq.write_table((old if table is None else table).replace_schema_metadata({KEY: json.dumps(metadata)}), path)


# What changes while, or after


def test_a_tag_that_comes_while_an_index_is_built_is_not_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_session(tmp_path / "a.mcap", STEERING)

    def tagging(log: Log, *rest: Any) -> pa.Table:
        add_tags(path, log.fingerprint, [Tag(0, 99, "exclude")])
        return frames_table(log, *rest)

    monkeypatch.setattr("dataset.index.log_entries.frames_table", tagging)
    build_index([path], tmp_path / "index")
    monkeypatch.undo()
    indexed = build_index([path], tmp_path / "index")
    assert indexed.counts["a"].excluded == 300
    assert min(indexed.samples["row"].to_pylist()) >= 100


def test_a_moved_index_finds_its_logs_again_or_reports_so(tmp_path: Path) -> None:
    path = write_session(tmp_path / "a.mcap", STEERING)
    build_index([path], tmp_path / "index")
    (tmp_path / "deep").mkdir()
    (tmp_path / "index").rename(tmp_path / "deep" / "index")
    with pytest.raises(DatasetError, match="bc-index"):
        Samples(tmp_path / "deep" / "index")
    build_index([path], tmp_path / "deep" / "index")
    Samples(tmp_path / "deep" / "index").close()


@pytest.mark.parametrize("name", ["build.SAMPLES_FORMAT", "log_entries.FRAMES_FORMAT"])
def test_an_index_of_an_older_toolkit_is_built_anew(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_session(tmp_path / "a.mcap", STEERING)
    build_index([path], tmp_path / "index")
    before = (tmp_path / "index" / "samples.parquet").stat().st_ino
    monkeypatch.setattr(f"dataset.index.{name}", 99)
    monkeypatch.setattr("dataset.frames.frames_file.FRAMES_FORMAT", 99)
    build_index([path], tmp_path / "index", IndexConfig(seed=1) if name == "log_entries.FRAMES_FORMAT" else None)
    assert (tmp_path / "index" / "samples.parquet").stat().st_ino != before


def test_an_index_with_views_of_an_earlier_version_is_refused(tmp_path: Path) -> None:
    log, index = write_session(tmp_path / "a.mcap", STEERING), tmp_path / "index"
    build_index([log], index)
    settings = json.loads(pq.read_schema(index / "samples.parquet").metadata[KEY])["settings"]
    rewrite(index / "samples.parquet", settings={**settings, "viewpoints": 0})
    with Samples(index) as samples:
        assert samples.settings == IndexConfig()
    rewrite(index / "samples.parquet", settings={**settings, "viewpoints": 2})
    with pytest.raises(DatasetError, match=r"samples\.parquet: has viewpoints.*run `bc-index` again"):
        Samples(index)
    build_index([log], index)
    Samples(index).close()


def test_two_who_build_one_index_at_once_follow_one_another(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from dataset import build_index;"
        "build_index([Path(sys.argv[1])], Path(sys.argv[2]))"
    )
    logs = [write_session(tmp_path / f"{name}.mcap", STEERING) for name in "ab"]
    lines = [[sys.executable, "-c", code, str(log), str(tmp_path / "index")] for log in logs * 2]
    with contextlib.ExitStack() as processes:
        running = [processes.enter_context(Process(line)) for line in lines]
        assert [process.join() for process in running] == [0] * 4, [process.stderr for process in running]
    Samples(tmp_path / "index").close()


# What cannot be


@pytest.mark.parametrize(
    "bad",
    [
        {"side_correction": float("nan")},
        {"side_correction": float("inf")},
        {"block_s": float("inf")},
        {"block_s": 1e-10},
        {"gap_s": float("nan")},
        {"alter": ("blur", "blur")},
        {"alter": ("none", "blur")},
        {"per_bin": 0},
        {"bins": 0},
        {"max_uses": 0},
        {"cameras": ()},
        {"seed": -1},
        {"label_smooth_s": 61},
        {"label_smooth_s": float("nan")},
        {"label_shift_s": -11},
        {"validation_share": 1.0},
    ],
    ids=str,
)
def test_settings_that_make_no_sense_are_refused(bad: dict[str, Any]) -> None:
    """By the flag, for that is what most people gave."""
    flag = f"--{next(iter(bad)).replace('_', '-')}"
    if "--label" in flag:
        flag = flag.removesuffix("-s")
    with pytest.raises(ValueError, match=f"^{flag} .*: expected "):
        Config(**bad)


def test_a_name_that_no_index_can_hold_is_refused(tmp_path: Path) -> None:
    for name in (b"caf\xe9.mcap", b".mcap", b"two\nlines.mcap"):
        path = tmp_path / os.fsdecode(name)
        write_log(path, [0.1])
        with pytest.raises(DatasetError, match="needs a name"):
            find_logs([str(path)], tmp_path)


def test_a_damaged_session_that_should_validate_is_an_error(tmp_path: Path) -> None:
    logs = [write_session(tmp_path / "a.mcap", STEERING), tmp_path / "b.mcap"]
    logs[1].write_bytes(b"no log")
    with pytest.raises(LogError, match=r"b\.mcap"):
        build_index(logs, tmp_path / "index", IndexConfig(validation=("b",)), leave_out_unreadable=True)


def test_a_split_without_samples_is_said(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_session(cwd / "sessions" / "a.mcap", STEERING[:30])
    assert call(main) == 3
    assert "no sample for validation" in capsys.readouterr().err
    assert call(main, "--block-s", 1, "--gap-s", 100) == 3
    assert "no sample for training" in capsys.readouterr().err
    assert call(main, "--validation-share", 0) == 0
