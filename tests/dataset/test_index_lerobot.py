"""`bc-index export --lerobot`: what an index uses of its logs becomes a dataset, and nothing else."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from common import UserError
from dataset import DatasetError, IndexConfig, build_index
from dataset.cli import main as bc_index
from dataset.index_export import export_index
from recorder import Log
from recorder.lerobot.export import Exported
from recorder.log.tags import Tag, add_tags
from recorder.sources.import_recording import import_recording
from tests.helpers.bucket import serving_bucket
from tests.helpers.driving import one_line_in
from tests.helpers.lerobot_logs import jpeg, steering, write_drives
from tests.helpers.udacity import call

START_NS, STEP_NS = 1_720_880_000_000_000_000, 100_000_000
TIMES_NS = [START_NS + STEP_NS * row for row in range(20)]
HALVES = IndexConfig(block_s=0.5, gap_s=0.0, validation_share=0.5)


def indexed(folder: Path, config: IndexConfig = HALVES, **about: Any) -> Path:
    """The index of a session of one drive of 20 rows."""
    log = write_drives(folder / "one.mcap", times_ns=TIMES_NS, **about)
    return build_index([log], folder / "index", config).path


def exported(index: Path, **options: Any) -> tuple[Exported, dict[str, list[Any]]]:
    done = export_index(index, index.with_name("out"), **options)
    table: dict[str, list[Any]] = pq.read_table(done.folder / "data").to_pydict()
    return done, table


def used(index: Path) -> dict[int, str]:
    """The side of the split of each row, as the index's own files tell."""
    frames = pq.read_table(index / "frames").to_pylist()
    return {frame["row"]: frame["split"] for frame in frames if frame["split"] != "gap"}


def test_rows_know_their_side_of_the_split_and_episodes_are_on_one(tmp_path: Path) -> None:
    index = indexed(tmp_path)
    done, table = exported(index)
    assert dict(zip(table["log_row"], table["split"], strict=True)) == used(index)
    assert set(table["split"]) == {"train", "validation"}
    episodes = pq.read_table(done.folder / "meta/episodes").to_pydict()
    by_episode: dict[int, set[str]] = {}
    for episode, split in zip(table["episode_index"], table["split"], strict=True):
        by_episode.setdefault(episode, set()).add(split)
    assert [{split} for split in episodes["split"]] == list(by_episode.values())
    changes = sum(a != b for a, b in zip(table["split"], table["split"][1:], strict=False))
    assert done.episodes == changes + 1
    assert json.loads((done.folder / "meta/info.json").read_text())["features"]["split"]["dtype"] == "string"
    assert "- `split`, also in `meta/episodes`" in (done.folder / "README.md").read_text()


def test_pictures_and_steering_are_those_of_the_log(tmp_path: Path) -> None:
    """Whatever the index learns of them: here everything is shifted, and no row is balanced away."""
    index = indexed(tmp_path, IndexConfig(block_s=0.5, gap_s=0.0, label_shift_s=0.1, max_uses=1))
    _, table = exported(index)
    for camera in ("center", "left", "right"):
        images = [image["bytes"] for image in table[f"observation.images.{camera}"]]
        assert images == [jpeg(camera, row) for row in table["log_row"]]
    assert [state[0] for state in table["log_vehicle"]] == [steering(row) for row in table["log_row"]]
    before = [0.0 if row == 0 else steering(row - 1) for row in table["log_row"]]  # also where the split changes
    assert [state[1] for state in table["observation.state"]] == np.array(before, np.float32).tolist()


def test_what_tags_gaps_and_conditions_leave_out_stays_out(tmp_path: Path) -> None:
    log = write_drives(tmp_path / "one.mcap", times_ns=TIMES_NS)
    with Log(log) as opened:
        add_tags(log, opened.fingerprint, [Tag(3, 4, "exclude")])
    config = IndexConfig(block_s=0.5, gap_s=0.1, validation_share=0.5, where="row != 7")
    index = build_index([log], tmp_path / "index", config).path
    kept = used(index).keys() - {3, 4, 7}
    done, table = exported(index, where="row < 18")
    assert set(table["log_row"]) == {row for row in kept if row < 18} != set(range(20)) - {3, 4, 7, 18, 19}
    assert len(table["log_row"]) == done.frames


def test_only_the_indexs_cameras_are_in_it(tmp_path: Path) -> None:
    index = indexed(tmp_path, IndexConfig(block_s=0.5, gap_s=0.0, cameras=("center",)))
    done, table = exported(index)
    assert done.pictures == done.frames == len(table["log_row"])
    assert "observation.images.left" not in table


def test_it_comes_back_as_a_log(tmp_path: Path) -> None:
    done, _ = exported(indexed(tmp_path))
    back = import_recording(done.folder, tmp_path / "back.mcap")
    assert (back.rows, back.pictures, list(back.skipped)) == (20, 60, [])


def test_logs_of_a_bucket_are_exported_as_those_of_a_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, local = exported(indexed(tmp_path))
    with serving_bucket(tmp_path, monkeypatch) as bucket:
        shutil.copy(tmp_path / "one.mcap", bucket.folder)
        index = build_index([bucket.url("one.mcap")], tmp_path / "far" / "index", HALVES).path
        _, stored = exported(index)
        assert stored == local


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    index = indexed(tmp_path)
    capsys.readouterr()
    flags = ("export", "--index", index, "--lerobot", tmp_path / "out", "--where", "row >= 10", "--license", "mit")
    assert call(bc_index, *flags) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"{tmp_path / 'out'}: ")
    assert ", 10 frames, 30 pictures, " in out
    assert call(bc_index, *flags) == 1
    assert "out exists already" in one_line_in(capsys)
    assert call(bc_index, "export", "--lerobot", tmp_path / "new", "--where", "no such thing") == 2
    assert "--where" in one_line_in(capsys)
    assert not (tmp_path / "new").exists()


def test_what_cannot_be_exported_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="nowhere: no index; build it with `bc-index"):
        export_index(tmp_path / "nowhere", tmp_path / "out")
    index = indexed(tmp_path)
    with pytest.raises(UserError, match="no used row meets --where 'row > 99'"):
        export_index(index, tmp_path / "out", where="row > 99")
    (tmp_path / "one.mcap").unlink()
    with pytest.raises(DatasetError, match="the log of session one is missing"):
        export_index(index, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_kept_condition_in_sql_is_named_with_the_new_spelling(tmp_path: Path) -> None:
    index = indexed(tmp_path, IndexConfig(block_s=0.5, where="row != 7"))
    samples = pq.read_table(index / "samples.parquet")
    about = json.loads(samples.schema.metadata[b"bc.index"])
    about["settings"]["where"] = "list_contains(tags, 'fog')"
    pq.write_table(samples.replace_schema_metadata({"bc.index": json.dumps(about)}), index / "samples.parquet")
    with pytest.raises(
        DatasetError, match=r"index: made with --where .*write 'recovery' in tags; .*`bc-index` again"
    ):
        export_index(index, tmp_path / "out")
