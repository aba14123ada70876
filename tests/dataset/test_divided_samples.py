"""Samples of an index that is too large for one file: a file a session, balanced as one file is."""

from __future__ import annotations

import shutil
from collections import Counter
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dataset import DatasetError, IndexConfig, Samples, build_index, load
from dataset.index.leaks import find_leaks
from dataset.samples.balance import PerBin, quota_of, shares
from divided import in_one_file
from logs import write_log
from recorder import Log
from recorder.log.tags import Tag, add_tags, tags_path
from web.index.index_view import session_bins_sketch, view_index

CONFIG = IndexConfig(labels="as-recorded", block_s=3.0, gap_s=0.5, validation_share=0.3)


def write_logs(folder: Path) -> list[Path]:
    """Sessions of different lengths and bends, one after the other."""
    random = np.random.default_rng(1)
    return [
        write_log(
            folder / f"drive {n}.mcap",
            np.clip(random.laplace(0.05 * n, 0.1 + 0.1 * n, rows), -1, 1).tolist(),
            start_ns=10**18 + n * 10**15,
        )
        for n, rows in enumerate((300, 40, 220))
    ]


def files_of(index: Path) -> dict[str, bytes]:
    return {str(path.relative_to(index)): path.read_bytes() for path in sorted(index.rglob("*.parquet"))}


def parts(index: Path) -> str:
    """The folder in which the only divided samples of an index are."""
    (folder,) = (index / "samples").iterdir()
    return folder.relative_to(index).as_posix()


def test_divided_samples_are_balanced_and_every_session_has_its_share(tmp_path: Path) -> None:
    logs = write_logs(tmp_path)
    one = build_index(logs, tmp_path / "one", CONFIG)
    divided = build_index(logs, tmp_path / "divided", CONFIG, divide_from_frames=1)
    files = [path for path in files_of(tmp_path / "divided") if not path.startswith("frames")]
    assert files == [*(f"{parts(tmp_path / 'divided')}/drive {n}.parquet" for n in range(3)), "samples.parquet"]
    assert divided.balance.as_dict() == one.balance.as_dict()
    assert divided.counts == one.counts
    tables = [indexed.samples.to_pylist() for indexed in (one, divided)]
    assert len(tables[0]) == len(tables[1])
    in_bins = [Counter((row["bin"], row["copy"]) for row in rows if row["split"] == "train") for rows in tables]
    assert in_bins[0] == in_bins[1]
    # what is held out is not drawn, and the same
    held_out = [[row for row in rows if row["split"] == "validation"] for rows in tables]
    assert held_out[0] == held_out[1]
    places = [(row["session"], row["offset"], row["flip"], row["copy"]) for row in tables[1]]
    assert places == sorted(places)
    uses = Counter(place[:3] for place in places)
    assert max(uses.values()) <= CONFIG.max_uses
    # of a bin that has more than it may keep, each session keeps the same part
    bin_of_all = int(np.argmax(one.balance.before))
    kept = one.balance.per_bin / one.balance.before[bin_of_all]
    for session in one.sessions:
        there, used = (
            sum(row["bin"] == bin_of_all and row["session"] == session for row in rows)
            for rows in (candidates(one), [row for row in tables[1] if row["split"] == "train"])
        )
        assert abs(used - kept * there) <= 1


def candidates(indexed: Any) -> list[dict[str, Any]]:
    """Frames for training, and their mirror images."""
    chosen = [
        {**row, "label": float(np.clip(row["steering"] + CORRECTIONS[row["camera"]], -1, 1))}
        for row in indexed.frames.to_pylist()
        if row["split"] == "train"
    ]
    both = [*chosen, *({**row, "label": -row["label"]} for row in chosen)]
    edges = np.linspace(-1, 1, CONFIG.bins + 1)
    return [
        {**row, "bin": int(np.clip(np.searchsorted(edges, row["label"], "right") - 1, 0, CONFIG.bins - 1))}
        for row in both
    ]


CORRECTIONS = {"center": 0.0, "left": CONFIG.side_correction, "right": -CONFIG.side_correction}


@given(
    st.lists(st.lists(st.integers(0, 40), min_size=5, max_size=5), min_size=1, max_size=6),
    st.sampled_from(["mean", "median", 3]),
    st.integers(1, 9),
)
def test_what_sessions_share_is_all_of_it_and_none_gives_more_than_it_has(
    counts: list[list[int]], per_bin: PerBin, max_uses: int
) -> None:
    there = np.array(counts)
    quota, _, _ = quota_of(there.sum(axis=0), max_uses, per_bin)
    divided = shares(quota, there)
    originals = np.stack([share.originals for share in divided])
    copies = np.stack([share.copies for share in divided])
    assert np.array_equal(originals.sum(axis=0), quota.originals)
    assert np.array_equal(copies.sum(axis=0), quota.copies)
    assert (originals >= 0).all()
    assert (originals <= there).all()
    assert (copies >= 0).all()
    assert (copies <= originals * (max_uses - 1)).all()
    exact = quota.originals * there / np.maximum(there.sum(axis=0), 1)
    assert (np.abs(originals - exact) <= 1).all()


def test_it_is_the_same_again_and_not_built_for_nothing(tmp_path: Path) -> None:
    logs = write_logs(tmp_path)
    build_index(logs, tmp_path / "a", CONFIG, divide_from_frames=1)
    build_index(logs[:2], tmp_path / "b", CONFIG)
    build_index(logs, tmp_path / "b", CONFIG, divide_from_frames=1)
    assert files_of(tmp_path / "a") == files_of(tmp_path / "b")
    before = {path: path.stat().st_ino for path in (tmp_path / "a").rglob("*.parquet")}
    build_index(logs, tmp_path / "a", CONFIG, divide_from_frames=1)
    assert {path: path.stat().st_ino for path in (tmp_path / "a").rglob("*.parquet")} == before
    (tmp_path / "a" / parts(tmp_path / "a") / "drive 1.parquet").unlink()
    build_index(logs, tmp_path / "a", CONFIG, divide_from_frames=1)
    assert files_of(tmp_path / "a") == files_of(tmp_path / "b")
    build_index(logs[:2], tmp_path / "a", CONFIG, divide_from_frames=1)
    assert len(files_of(tmp_path / "a")) == 5
    build_index(logs, tmp_path / "a", CONFIG)
    build_index(logs, tmp_path / "c", CONFIG)
    assert files_of(tmp_path / "a") == files_of(tmp_path / "c")
    assert not (tmp_path / "a" / "samples").exists()


def test_what_reads_an_index_reads_a_divided_one(tmp_path: Path) -> None:
    logs = write_logs(tmp_path)
    indexed = build_index(logs, tmp_path / "index", CONFIG, divide_from_frames=1)
    expected = indexed.samples
    with Samples(tmp_path / "index") as samples:
        assert samples.table.to_pylist() == expected.to_pylist()
        for split in ("train", "validation"):
            assert samples.of_split(split)["label"].to_pylist() == [
                row["label"] for row in expected.to_pylist() if row["split"] == split
            ]
        divided = samples.fingerprint
    # as one file, the same samples are the same to whoever learns from them
    whole = in_one_file(tmp_path / "index", tmp_path / "whole")
    with Samples(whole) as samples:
        assert samples.fingerprint == divided
    with load(tmp_path / "index", batch=8) as loader, load(whole, batch=8) as of_whole:
        for field in fields(loader.rows):
            assert np.array_equal(getattr(loader.rows, field.name), getattr(of_whole.rows, field.name)), field.name
        assert len(loader) == sum(row["split"] == "train" for row in expected.to_pylist())
    assert find_leaks(tmp_path / "index") == []
    assert view_index(tmp_path / "index").after == indexed.balance.after.tolist()
    assert session_bins_sketch(tmp_path / "index", "drive 1") == session_bins_sketch(whole, "drive 1")


def test_parts_that_are_missing_or_of_another_index_are_told(tmp_path: Path) -> None:
    logs = write_logs(tmp_path)
    build_index(logs, tmp_path / "index", CONFIG, divide_from_frames=1)
    build_index(logs, tmp_path / "other", IndexConfig(labels="as-recorded", seed=7), divide_from_frames=1)
    here, there = (tmp_path / name / parts(tmp_path / name) for name in ("index", "other"))
    shutil.copy(there / "drive 1.parquet", here)
    is_told = pytest.raises(DatasetError, match=r"drive 1\.parquet is not of it")
    with Samples(tmp_path / "index") as samples, is_told:
        _ = samples.table
    (here / "drive 0.parquet").unlink()
    with Samples(tmp_path / "index") as samples, pytest.raises(DatasetError, match=r"drive 0\.parquet"):
        _ = samples.table


def test_a_folder_of_that_name_that_is_somebody_elses_stays(tmp_path: Path) -> None:
    logs = write_logs(tmp_path)
    mine = tmp_path / "index" / "samples" / "mine.txt"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    build_index(logs, tmp_path / "index", CONFIG, divide_from_frames=1)
    assert len(files_of(tmp_path / "index")) == 7
    build_index(logs, tmp_path / "index", CONFIG)
    assert list(mine.parent.iterdir()) == [mine]
    mine.unlink()
    mine.parent.rmdir()
    mine.parent.write_text("a file")
    with pytest.raises(DatasetError, match="samples: not a plain folder; remove it"):
        build_index(logs, tmp_path / "index", CONFIG, divide_from_frames=1)


def test_samples_of_other_frames_differ_where_their_number_is_equal(tmp_path: Path) -> None:
    log = write_log(tmp_path / "a.mcap", [0.1, 0.2] * 100)
    folders = set[str]()
    with Log(log) as opened:
        fingerprint = opened.fingerprint
    for row in (10, 12):  # of the same block, with the same steering
        tags_path(log).unlink(missing_ok=True)
        add_tags(log, fingerprint, [Tag(row, row, "exclude")])
        indexed = build_index([log], tmp_path / "index", CONFIG, divide_from_frames=1)
        assert indexed.counts["a"].excluded == 3
        assert row not in indexed.samples["row"].to_pylist()
        folders.add(parts(tmp_path / "index"))
    assert len(folders) == 2
