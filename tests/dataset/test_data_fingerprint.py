"""One number tells what a network was trained on: it changes with what training reads, and with no path."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dataset import IndexConfig, Samples, build_index
from recorder import Log
from recorder.log.tags import Tag, add_tags
from tests.helpers.logs import write_session

STEERING = [round(0.02 * (row % 40) - 0.4, 2) for row in range(80)]
CONFIG = IndexConfig(block_s=1.0, gap_s=0.2)


def fingerprint(index: Path) -> str:
    with Samples(index) as samples:
        return samples.fingerprint


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with two logs, and with `index` of the first one."""
    folder = tmp_path / "here"
    folder.mkdir()
    write_session(folder / "b.mcap", [-value for value in STEERING])
    build_index([write_session(folder / "a.mcap", STEERING)], folder / "index", CONFIG)
    return folder


def test_it_is_the_same_for_the_same_data_wherever_that_lies(folder: Path, tmp_path: Path) -> None:
    before = fingerprint(folder / "index")
    assert len(bytes.fromhex(before)) == 32
    folder.rename(tmp_path / "there")
    assert fingerprint(tmp_path / "there" / "index") == before
    shutil.rmtree(tmp_path / "there" / "index")
    build_index([tmp_path / "there" / "a.mcap"], tmp_path / "elsewhere" / "index", CONFIG)
    assert fingerprint(tmp_path / "elsewhere" / "index") == before


def test_it_changes_with_a_tag_a_setting_and_another_log(folder: Path) -> None:
    log, other, index = folder / "a.mcap", folder / "b.mcap", folder / "index"
    seen = [fingerprint(index)]
    for config in (IndexConfig(block_s=1.0, gap_s=0.2, seed=1), IndexConfig(block_s=1.0, gap_s=0.2, flip=False)):
        build_index([log], index, config)
        seen.append(fingerprint(index))
    for logs in ([other], [log, other]):
        build_index(logs, index, CONFIG)
        seen.append(fingerprint(index))
    with Log(log) as opened:
        add_tags(log, opened.fingerprint, [Tag(5, 5, "exclude")])
    build_index([log], index, CONFIG)
    seen.append(fingerprint(index))
    assert len(set(seen)) == len(seen)


def last_changed(name: str, value: object) -> Callable[[pa.Table], pa.Table]:
    """The last value of a column is another one."""

    def change(table: pa.Table) -> pa.Table:
        field = table.schema.field(name)
        assert table[name][-1].as_py() != value
        values = pa.array([*table[name].to_pylist()[:-1], value], field.type)
        return table.set_column(table.schema.get_field_index(name), field, values)

    return change


CHANGES = {
    "session": "a",  # the last sample is of b
    "camera": "center",
    "offset": 7,
    "length": 7,
    "chunk": 7,
    "flip": False,
    "alteration": "blur",
    "seed": 7,
    "label": 0.123,
    "recorded": 0.123,
    "split": "validation",
    "copy": False,
}


def test_it_changes_with_a_single_value_of_any_column_that_is_read(folder: Path) -> None:
    path = folder / "index" / "samples.parquet"
    build_index([folder / "a.mcap", folder / "b.mcap"], folder / "index", IndexConfig(validation=("a",)))
    table = pq.read_table(path)
    fingerprints = {fingerprint(folder / "index")}
    for name, value in CHANGES.items():
        pq.write_table(last_changed(name, value)(table), path)
        fingerprints.add(fingerprint(folder / "index"))
    assert len(fingerprints) == 1 + len(CHANGES)
