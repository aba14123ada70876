"""One number tells what a network was trained on: it changes with what training reads, and with no path."""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.car import CAMERAS
from dataset import DatasetError, IndexConfig, Samples, build_index
from dataset.frames.frames_table import frames_of
from dataset.index.build_state import BuiltLog
from dataset.index.session_labels import labels_of_sessions
from dataset.parquet_file import write_table
from dataset.samples.samples_writer import write_samples
from dataset.steering_bins import bin_of
from recorder import Log, Pictures
from recorder.log.tags import Tag, add_tags
from recorder.rows.row_quality import States
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


def test_it_is_the_same_however_the_file_is_laid_out(folder: Path) -> None:
    before, path = fingerprint(folder / "index"), folder / "index" / "samples.parquet"
    pq.write_table(pq.read_table(path), path, row_group_size=7, use_dictionary=False, compression="none")
    assert fingerprint(folder / "index") == before


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


STEP_NS = 100_000_000

steerings = st.one_of(st.floats(-1, 1), st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.04, -0.04]))
odd = st.one_of(steerings, st.sampled_from([float("nan"), float("inf"), 1.5, -7.0]))
drives = st.lists(st.lists(odd, min_size=1, max_size=120), min_size=1, max_size=3)
configs = st.builds(
    IndexConfig,
    bins=st.sampled_from([1, 5, 25]),
    balance=st.booleans(),
    per_bin=st.sampled_from(["mean", "median", 7]),
    max_uses=st.integers(1, 12),
    flip=st.booleans(),
    cameras=st.sampled_from([("center",), ("left", "right"), CAMERAS]),
    side_correction=st.sampled_from([0.0, 0.2, 1.5]),
    alter=st.sampled_from([("none",), ("blur",), ("blur", "brightness", "shadow")]),
    block_s=st.sampled_from([1.0, 3.0]),
    gap_s=st.sampled_from([0.0, 0.5]),
    validation_share=st.sampled_from([0.0, 0.2, 0.5]),
    seed=st.integers(0, 3),
)


def write_index(
    folder: Path, sessions: list[list[float]], config: IndexConfig
) -> tuple[list[dict[str, Any]], ...]:
    """Frames and samples of sessions of one drive each, a row every tenth of a second."""
    files = {}
    frames: list[dict[str, Any]] = []
    for number, steering in enumerate(sessions):
        row = np.arange(len(steering))
        time_ns = 10**18 + number * 10**12 + row * STEP_NS
        zero = np.zeros(len(row))
        states = States(row, time_ns, np.array(steering, np.float64), zero, zero, zero + 9)
        places = {
            camera: Pictures(row, time_ns, 1000 * row + 300 * i, row * 0 + 200, row * 0 - 1)
            for i, camera in enumerate(CAMERAS)
        }
        table = frames_of(states, places, f"s{number}", config)
        frames += table.to_pylist()
        files[f"s{number}"] = folder / f"s{number}.parquet"
        write_table(files[f"s{number}"], table, {})
    built = {name: BuiltLog(("", None, None, None), set_speeds_mph=()) for name in files}
    labels = labels_of_sessions(files, built, config)  # so short, that no log is looked into
    write_samples(files, folder / "samples.parquet", config, {}, labels)
    return frames, pq.read_table(folder / "samples.parquet").to_pylist()


@given(drives, configs)
def test_whatever_is_driven_the_samples_keep_their_promises(
    sessions: list[list[float]], config: IndexConfig
) -> None:
    usable = [value for steering in sessions for value in steering if abs(value) <= 1]
    with tempfile.TemporaryDirectory() as name:
        if not usable:
            with pytest.raises(DatasetError, match="no frame can be used"):
                write_index(Path(name), sessions, config)
            return
        frames, samples = write_index(Path(name), sessions, config)

    by_place = {(frame["session"], frame["row"], frame["camera"]): frame for frame in frames}
    correction = {"center": 0.0, "left": config.side_correction, "right": -config.side_correction}
    uses: Counter[tuple[Any, ...]] = Counter()
    split_of_row: dict[tuple[str, int], set[str]] = defaultdict(set)
    for sample in samples:
        frame = by_place[sample["session"], sample["row"], sample["camera"]]
        # label and picture belong together
        assert all(sample[key] == frame[key] for key in ("offset", "length", "chunk", "log_time_ns", "split"))
        straight = min(max(frame["steering"] + correction[sample["camera"]], -1.0), 1.0)
        assert sample["label"] == (-straight if sample["flip"] else straight)
        assert sample["bin"] == bin_of(np.array([sample["label"]]), config.bins)[0]
        # only copies are altered; validation has none
        assert sample["copy"] or (sample["alteration"] == "" and sample["seed"] == 0)
        assert not (sample["copy"] and sample["split"] == "validation")
        assert set(filter(None, sample["alteration"].split("+"))) <= set(config.alterations)
        assert sample["split"] != "gap"
        uses[sample["session"], sample["row"], sample["camera"], sample["flip"]] += 1
        split_of_row[sample["session"], sample["row"]].add(sample["split"])
    # a row and all its cameras, mirror images and copies are on one side
    assert all(len(split) == 1 for split in split_of_row.values())
    assert max(uses.values()) <= config.max_uses
    assert all(count == 1 or by_place[key[:3]]["split"] == "train" for key, count in uses.items())
    flips = {False, True} if config.flip else {False}
    assert {key[3] for key in uses} <= flips
    # validation has every picture, and its mirror image; so has training, where it is not balanced
    whole = {"validation"} if config.balance else {"validation", "train"}
    usable_frames = [
        frame for frame in frames if frame["camera"] in config.cameras and abs(frame["steering"]) <= 1
    ]
    assert {key for key in uses if by_place[key[:3]]["split"] in whole} == {
        (frame["session"], frame["row"], frame["camera"], flip)
        for frame in usable_frames
        if frame["split"] in whole
        for flip in flips
    }
    # every bin of the training split has what was promised
    wanted = [frame for frame in usable_frames if frame["split"] == "train"]
    labels = np.clip([frame["steering"] + correction[frame["camera"]] for frame in wanted], -1.0, 1.0) + 0.0
    candidates = Counter(bin_of(labels, config.bins).tolist())
    if config.flip:
        candidates.update(bin_of(-labels + 0.0, config.bins).tolist())
    after = Counter(sample["bin"] for sample in samples if sample["split"] == "train")
    if not config.balance:
        assert after == candidates
    elif candidates:
        counts = list(candidates.values())
        target = {"mean": round(np.mean(counts)), "median": round(np.median(counts))}.get(
            str(config.per_bin), config.per_bin
        )
        assert after == {at: min(target, count * config.max_uses) for at, count in candidates.items()}
