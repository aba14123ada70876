"""How an index is made: conditions, the leak check, and what is not done twice."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.errors import UsageError
from dataset import DatasetError, IndexConfig, build_index
from dataset.cli import main
from dataset.frames.split import near_validation
from dataset.index.leaks import find_leaks
from recorder import Log
from recorder.log.tags import Tag, add_tags
from recorder.upkeep.edit import merge
from tests.helpers.logs import write_log, write_session
from tests.helpers.udacity import call

STEERING = [round(0.02 * (row % 40) - 0.4, 2) for row in range(300)]  # 30 s


# Questions


@pytest.mark.parametrize(
    ("where", "rows"),
    [
        ("'recovery' in tags", set(range(50, 80))),
        ("row < 20 and session = 'a' and camera != 'left'", set(range(20))),
    ],
)
def test_a_condition_chooses_frames(tmp_path: Path, where: str, rows: set[int]) -> None:
    path = write_session(tmp_path / "a.mcap", STEERING)
    with Log(path) as log:
        add_tags(path, log.fingerprint, [Tag(50, 79, "recovery")])
    config = IndexConfig(where=where, balance=False, gap_s=0)
    indexed = build_index([path], tmp_path / "index", config)
    assert set(indexed.samples["row"].to_pylist()) == rows
    stored = json.loads(pq.read_schema(tmp_path / "index" / "samples.parquet").metadata[b"bc.index"])
    assert stored["settings"]["where"] == where
    assert indexed.counts["a"].not_asked_for == 900 - len(indexed.samples) // 2


def test_what_is_no_condition_is_an_error_that_names_the_columns(tmp_path: Path) -> None:
    log = write_session(tmp_path / "a.mcap", STEERING)
    for where in ("speed >", "nonsense = 1", "row in (select 1"):
        with pytest.raises(UsageError, match=r"--where .*columns are session, row, camera"):
            build_index([log], tmp_path / "index", IndexConfig(where=where))
    assert not (tmp_path / "index").exists()


def test_an_index_of_nothing_reports_what_became_of_the_frames(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", [0.0] * 4 + [1.5] * 3, cameras=["center", "left"])
    with pytest.raises(DatasetError) as raised:
        build_index([path], tmp_path / "index", IndexConfig(where="steering > 1", cameras=("left",)))
    assert "11 not of a camera left or not chosen by --where, 3 with a broken picture" in str(raised.value)
    for steering in ([0.0] * 4, []):
        empty = write_log(tmp_path / "empty.mcap", steering, cameras=[], overwrite=True)
        with pytest.raises(DatasetError, match=r"no picture in empty\.mcap; look with `bc-log check`"):
            build_index([empty], tmp_path / "index")
    assert not (tmp_path / "index" / "samples.parquet").exists()


# The split


@given(st.lists(st.tuples(st.floats(-0.4, 0.4), st.booleans()), max_size=60), st.sampled_from([0, 0.5, 2]))
def test_the_gap_is_what_lies_near_a_held_out_row_along_the_recording(
    rows: list[tuple[float, bool]], gap_s: float
) -> None:
    steps_ns = [int(step * 1e9) for step, _ in rows]
    held_out = np.array([flag for _, flag in rows], np.bool_)

    def apart_ns(first: int, second: int) -> int:
        """Also where the clock was set back between the two."""
        low, high = sorted((first, second))
        return sum(map(abs, steps_ns[low + 1 : high + 1]))

    expected = [
        not held_out[i] and any(held_out[j] and apart_ns(i, j) <= gap_s * 1e9 for j in range(len(rows)))
        for i in range(len(rows))
    ]
    time_ns = np.cumsum(steps_ns).astype(np.int64)
    assert near_validation(time_ns, held_out, gap_s).tolist() == expected


def test_an_index_has_no_leak(tmp_path: Path) -> None:
    logs = [write_session(tmp_path / "a.mcap", STEERING), write_session(tmp_path / "b.mcap", STEERING[::-1])]
    assert find_leaks(build_index(logs, tmp_path / "index", IndexConfig(block_s=3)).path) == []
    assert find_leaks(build_index(logs, tmp_path / "index", IndexConfig(validation=("b",))).path) == []


def leak_of(tmp_path: Path, **changed: object) -> list[str]:
    """The leaks of an index in whose samples some columns were changed by hand for one row of the log."""
    path = write_session(tmp_path / "a.mcap", STEERING)
    index = build_index([path], tmp_path / "index", IndexConfig(block_s=3, flip=False)).path
    samples = pq.read_table(index / "samples.parquet")
    rows = samples.to_pylist()
    victim = next(row for row in rows if row["split"] == "validation")
    extra = {**victim, **changed}
    pq.write_table(pa.Table.from_pylist([*rows, extra], samples.schema), index / "samples.parquet")
    return find_leaks(index)


def test_a_drive_that_a_merged_log_holds_twice_is_a_leak(tmp_path: Path) -> None:
    first = write_session(tmp_path / "a.mcap", STEERING)
    other = write_session(tmp_path / "b.mcap", STEERING[::-1])  # at the same times, with pictures as long
    for again, leaks in ((first, 1), (other, 0)):
        log = merge([first, again], tmp_path / f"with-{again.name}").path
        found = find_leaks(build_index([log], tmp_path / again.stem, IndexConfig(block_s=3)).path)
        assert len(found) == leaks
        assert all("in validation a second time" in leak for leak in found)


def test_an_altered_picture_in_validation_is_a_leak(tmp_path: Path) -> None:
    [leak] = leak_of(tmp_path, alteration="blur", seed=3)
    assert "1 sample of validation altered, or a copy" in leak


def test_training_within_the_gap_is_a_leak(tmp_path: Path) -> None:
    path = write_session(tmp_path / "a.mcap", STEERING)
    index = build_index([path], tmp_path / "index", IndexConfig(block_s=3, flip=False, validation_share=0.3)).path
    frames = pq.read_table(index / "frames" / "a.parquet").to_pylist()
    samples = pq.read_table(index / "samples.parquet")
    rows = samples.to_pylist()
    gap = sorted({row["row"] for row in frames if row["split"] == "gap"})
    assert sum(np.diff(gap) > 1) > 1  # around more than one stretch that is held out
    for row in gap:
        extra = {**rows[0], "row": row, "split": "train"}
        pq.write_table(pa.Table.from_pylist([*rows, extra], samples.schema), index / "samples.parquet")
        [leak] = find_leaks(index)
        assert f"training row {row} is " in leak
        assert "s from validation, within the gap of 1 s" in leak


def test_an_excluded_row_in_use_is_a_leak(tmp_path: Path) -> None:
    path = write_session(tmp_path / "a.mcap", STEERING)
    index = build_index([path], tmp_path / "index", IndexConfig(block_s=3)).path
    before = (index / "samples.parquet").read_bytes()
    with Log(path) as log:
        add_tags(path, log.fingerprint, [Tag(0, 9, "exclude")])
    build_index([path], index, IndexConfig(block_s=3))
    (index / "samples.parquet").write_bytes(before)
    assert any("tagged `exclude` and used" in leak for leak in find_leaks(index))


def test_bc_index_check_reports_so(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_session(cwd / "sessions" / "a.mcap", STEERING)
    assert call(main, "--check", "--block-s", 3) == 0
    assert "no leak" in capsys.readouterr().out


# Nothing is done twice


def test_an_unchanged_index_is_not_even_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logs = [write_session(tmp_path / "a.mcap", STEERING), write_session(tmp_path / "b.mcap", STEERING[::-1])]
    first = build_index(logs, tmp_path / "index")

    def opened(path: Path) -> Log:
        raise AssertionError(f"{path} was opened")

    monkeypatch.setattr("dataset.index.log_entries.Log", opened)
    again = build_index(logs, tmp_path / "index")
    assert again.read == []
    assert (again.counts, again.balance.as_dict()) == (first.counts, first.balance.as_dict())
    assert again.samples.equals(first.samples)


def test_a_log_that_was_touched_is_looked_at_and_left(tmp_path: Path) -> None:
    log = write_session(tmp_path / "a.mcap", STEERING)
    build_index([log], tmp_path / "index")
    before = (tmp_path / "index" / "samples.parquet").read_bytes()
    os.utime(log, ns=(0, 0))
    assert build_index([log], tmp_path / "index").read == []
    assert (tmp_path / "index" / "samples.parquet").read_bytes() == before
