"""The index: where each picture lies, which split it is in, and how the steering is balanced."""

from __future__ import annotations

import hashlib
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dataset import DatasetError, IndexConfig, Indexed, build_index, find_logs
from dataset.cli import main
from dataset.frames.split import block_numbers, validation_blocks
from dataset.samples.sample_choice import balance
from dataset.steering_bins import bin_of
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.rows.row_quality import drive_numbers
from tests.helpers.logs import START_NS, STEP_NS, plain_read, write_log, write_session
from tests.helpers.udacity import call

STEERING = [0.0] * 150 + [round(0.9 * np.sin(i / 7), 3) for i in range(150)]  # straight on, then bends: 30 s
BLOCKS = IndexConfig(block_s=2.0)

distributions = st.lists(st.floats(-1, 1), min_size=1, max_size=300)
bins_from_1 = st.integers(1, 40)


def index_of(folder: Path, config: IndexConfig = BLOCKS, **sessions: list[float]) -> Indexed:
    logs = [write_session(folder / f"{name}.mcap", steering) for name, steering in sessions.items()]
    return build_index(logs, folder / "index", config)


def rows_of(path: Path) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = pq.read_table(path).to_pylist()
    return rows


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


# Bins and balance


@given(distributions, bins_from_1)
def test_a_mirrored_steering_falls_into_the_mirrored_bin(values: list[float], bins: int) -> None:
    steering = np.array(values)
    left, right = bin_of(-steering, bins), bin_of(steering, bins)
    turning = steering != 0
    assert left[turning].tolist() == (bins - 1 - right[turning]).tolist()
    assert ((right >= 0) & (right < bins)).all()


def test_twenty_five_bins_are_each_eight_hundredths_wide() -> None:
    steering = np.array([-1.0, -0.93, -0.91, -0.05, -0.03, 0.0, 0.03, 0.05, 1.0])
    assert bin_of(steering, 25).tolist() == [0, 0, 1, 11, 12, 12, 12, 13, 24]


@given(
    distributions,
    bins_from_1,
    st.integers(1, 12),
    st.sampled_from(["mean", "median", 1, 7, 50]),
    st.integers(0, 5),
)
def test_every_filled_bin_holds_what_was_asked_for_or_the_cap_allows(
    values: list[float], bins: int, max_uses: int, per_bin: Any, seed: int
) -> None:
    bin_numbers = bin_of(np.array(values), bins)
    before = Counter(bin_numbers.tolist())
    done = balance(bin_numbers, bins, max_uses, np.random.default_rng(seed), per_bin)
    counts = list(before.values())
    target = {"mean": round(np.mean(counts)), "median": round(np.median(counts))}.get(per_bin, per_bin)
    assert done.per_bin == target
    after = Counter(bin_numbers[done.chosen].tolist())
    assert after == {i: min(target, max_uses * originals) for i, originals in before.items()}
    assert done.short == {i: target - after[i] for i in before if after[i] < target}
    uses = Counter(done.chosen.tolist())
    assert max(uses.values()) <= max_uses
    # an original is itself once, and its further uses are copies
    assert Counter(done.chosen[~done.is_copy].tolist()) == dict.fromkeys(uses, 1)
    for i in before:  # copies are spread evenly
        shared = [count for position, count in uses.items() if bin_numbers[position] == i]
        assert max(shared) - min(shared) <= 1


# Samples


def test_only_copies_are_altered_each_alteration_in_half_of_them(tmp_path: Path) -> None:
    samples = index_of(tmp_path, IndexConfig(validation_share=0.0), a=STEERING).samples.to_pylist()
    copies = [row for row in samples if row["copy"]]
    assert {row["alteration"] for row in samples if not row["copy"]} == {""}
    assert len(copies) > 500
    for name in ("blur", "brightness", "shadow"):
        share = sum(name in row["alteration"].split("+") for row in copies) / len(copies)
        assert share == pytest.approx(0.5, abs=4 * 0.5 / len(copies) ** 0.5)  # four standard deviations
    unaltered = index_of(tmp_path, IndexConfig(validation_share=0.0, alter=()), a=STEERING).samples.to_pylist()
    assert {row["alteration"] for row in unaltered} == {""}
    assert sum(row["copy"] for row in unaltered) == len(copies)


def test_steering_out_of_range_is_flagged_and_left_out(tmp_path: Path) -> None:
    indexed = index_of(tmp_path, a=[0.1, 1.5, float("nan"), -1.0001, 0.2])
    frames = indexed.frames.to_pylist()
    assert {row["row"] for row in frames if row["flags"]} == {1, 2, 3}
    assert {tuple(row["flags"]) for row in frames} == {(), ("out_of_range",)}
    assert {row["bin"] for row in frames if row["flags"]} == {-1}
    assert {row["row"] for row in indexed.samples.to_pylist()} == {0, 4}


# Splits


def test_the_split_is_by_blocks_of_time(tmp_path: Path) -> None:
    frames = [row for row in index_of(tmp_path, a=STEERING).frames.to_pylist() if row["camera"] == "center"]
    assert [row["block"] for row in frames] == [row["row"] // 20 for row in frames]  # 2 s of 0.1 s each
    assert sum(row["split"] == "validation" for row in frames) == 60  # a fifth of 300
    held_out = {row["row"] for row in frames if row["split"] == "validation"}
    assert {row["block"] for row in frames if row["row"] in held_out} == {row // 20 for row in held_out}
    for row in frames:  # a second is left out on either side of a block that is held out
        near = min(abs(row["row"] - other) for other in held_out) <= 10
        assert row["split"] == ("validation" if row["row"] in held_out else "gap" if near else "train")


@pytest.mark.parametrize("seed", range(4))
def test_a_drive_of_two_blocks_is_learnt_for_more_than_half(tmp_path: Path, seed: int) -> None:
    """Chance may choose the longer block."""
    index = index_of(tmp_path, IndexConfig(seed=seed, block_s=5, gap_s=0), a=STEERING[:60]).path
    frames = rows_of(index / "frames" / "a.parquet")
    assert Counter(row["split"] for row in frames) == {"train": 150, "validation": 30}


def test_whole_sessions_are_held_out_if_they_are_named(tmp_path: Path) -> None:
    indexed = index_of(tmp_path, IndexConfig(validation=("b",)), a=STEERING, b=STEERING[::-1], c=STEERING[1:])
    split = {(row["session"], row["split"]) for row in indexed.samples.to_pylist()}
    assert split == {("a", "train"), ("b", "validation"), ("c", "train")}
    with pytest.raises(DatasetError, match=r"--validation d: no such session among a, b, c"):
        index_of(tmp_path, IndexConfig(validation=("b", "d")), a=STEERING, b=STEERING[::-1], c=STEERING[1:])


@given(st.lists(st.integers(-3_000, 3_000), min_size=1, max_size=200), st.integers(1, 20))
def test_a_drive_and_its_block_end_at_a_gap_and_where_time_goes_back(steps_ms: list[int], block_s: int) -> None:
    time_ns = np.cumsum(np.array(steps_ms, np.int64)) * 1_000_000
    drive = drive_numbers(time_ns)
    block = block_numbers(time_ns, drive, block_s)
    for i in range(1, len(time_ns)):
        assert (drive[i] > drive[i - 1]) == (steps_ms[i] < 0 or steps_ms[i] > 1000)
        assert block[i] > block[i - 1] or drive[i] == drive[i - 1]
    for number in range(block[-1] + 1):
        within = time_ns[block == number]
        assert len(within)
        assert within.max() - within.min() < block_s * 1_000_000_000


@given(st.lists(st.integers(1, 50), min_size=2, max_size=30), st.floats(0.05, 0.5), st.integers(0, 9))
def test_validation_is_as_near_to_its_share_as_whole_blocks_allow(
    lengths: list[int], share: float, seed: int
) -> None:
    block = np.repeat(np.arange(len(lengths)), lengths)
    taken = validation_blocks(block, share, seed, "session")
    assert 1 <= len(taken) < len(lengths)
    assert abs(sum(lengths[i] for i in taken) - share * len(block)) <= max(lengths)


def test_another_session_moves_no_ones_split(tmp_path: Path) -> None:
    alone = rows_of(index_of(tmp_path, a=STEERING).path / "frames" / "a.parquet")
    together = rows_of(index_of(tmp_path, a=STEERING, b=STEERING[::-1]).path / "frames" / "a.parquet")
    assert [row["split"] for row in alone] == [row["split"] for row in together]


# Frames


def test_ranges_lead_to_the_pictures_bytes_and_values_to_their_rows(tmp_path: Path) -> None:
    indexed = index_of(tmp_path, a=STEERING)
    frames = rows_of(indexed.path / "frames" / "a.parquet")
    assert len(frames) == 3 * len(STEERING)
    for row in frames:
        expected = f"{row['session']} {row['camera']} {row['row']}".encode()
        assert plain_read(tmp_path / "a.mcap", row["offset"], row["length"]) == expected
        values = [row[name] for name in ("log_time_ns", "steering", "throttle", "brake", "speed_mph")]
        assert values == [START_NS + row["row"] * STEP_NS, STEERING[row["row"]], 0.5, 0.0, 9.0]


# The same bytes, and nothing read twice


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(tmp_path: Path) -> None:
    def samples(seed: int) -> str:
        config = IndexConfig(block_s=2.0, seed=seed)
        return digest(index_of(tmp_path, config, a=STEERING, b=[0.3] * 50).path / "samples.parquet")

    first = samples(1)
    assert samples(2) != first
    assert samples(1) == first


def test_only_what_changed_is_read_again(tmp_path: Path) -> None:
    logs = [write_session(tmp_path / "a.mcap", STEERING), write_session(tmp_path / "b.mcap", STEERING[::-1])]
    index = tmp_path / "index"

    def read_again(config: IndexConfig = BLOCKS) -> list[str]:
        return build_index(logs, index, config).read

    assert read_again() == ["a", "b"]
    before = [digest(path) for path in sorted(index.rglob("*.parquet"))]
    assert read_again() == []
    assert [digest(path) for path in sorted(index.rglob("*.parquet"))] == before
    write_session(logs[1], STEERING[1:])
    assert read_again() == ["b"]
    (index / "frames" / "a.parquet").unlink()
    assert read_again() == ["a"]
    (index / "frames" / "a.parquet").write_bytes(b"garbage")
    assert read_again() == ["a"]
    with (index / "frames" / "b.parquet").open("rb+") as stream:  # its data damaged, its metadata whole
        stream.seek(10)
        stream.write(bytes(300))
    assert read_again() == ["b"]
    assert digest(index / "frames" / "a.parquet") == before[0]
    assert read_again(IndexConfig(block_s=3.0)) == ["a", "b"]
    assert read_again(IndexConfig(block_s=3.0, max_uses=2)) == []


def test_a_session_that_is_gone_vanishes_and_strangers_files_stay(tmp_path: Path) -> None:
    indexed = index_of(tmp_path, a=STEERING, b=STEERING[::-1])
    note = indexed.path / "frames" / "mine.parquet"
    note.write_bytes(b"not ours")
    (tmp_path / "b.mcap").unlink()
    again = build_index(find_logs((), tmp_path), indexed.path)
    assert again.sessions == ["a"]
    assert {row["session"] for row in rows_of(indexed.path / "samples.parquet")} == {"a"}
    assert sorted(path.name for path in note.parent.iterdir()) == ["a.parquet", "mine.parquet"]


# Errors and the command


def standing_start(path: Path, rows: int, standing: int) -> Path:
    """It begins as every drive of a simulator that always does the same; then its pictures are its own."""
    with LogWriter(path, {"source": "test"}) as writer:
        for row in range(rows):
            picture = b"start%05d" % row if row < standing else b"%s%05d" % (path.stem.encode(), row)
            writer.picture("center", 10**18 + row * 10**8, row, picture)
            state = VehicleState(steering=0.1, speed_mph=0.0 if row < standing else 20.0)
            writer.vehicle(10**18 + row * 10**8, row, state)
    return path


def test_a_standing_start_that_two_drives_share_is_not_held_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = [standing_start(tmp_path / f"{name}.mcap", 400, 12) for name in "abcd"]
    config = IndexConfig(validation=("a",), flip=False, balance=False)  # the start of a would be held out
    indexed = build_index(logs, tmp_path / "index", config)
    held_out = indexed.samples.filter(pc.equal(indexed.samples["split"], "validation"))
    assert sorted(held_out["row"].to_pylist()) == list(range(12, 400))
    assert indexed.counts["a"].gap == 12
    assert {indexed.counts[name].training for name in "bcd"} == {400}
    assert call(main, "--sessions", tmp_path, "--index", tmp_path / "again") == 0
    printed = " ".join(capsys.readouterr().err.split())
    assert "same pictures of a standing car in several sessions: a (12 rows from row 0), b (12" in printed


@pytest.mark.parametrize(("second", "is_hinted"), [({}, True), ({"drive.seed": "1"}, False)])
def test_a_track_that_was_driven_twice_with_one_seed_is_said_to_be(
    tmp_path: Path, second: dict[str, str], is_hinted: bool
) -> None:
    driven = {"track_fingerprint": "f", "driver": "expert", "drive.seed": "0"}
    for name, metadata in (("a", driven), ("b", {**driven, **second})):
        with LogWriter(tmp_path / f"{name}.mcap", metadata) as writer:
            for row in range(5):
                writer.picture("center", 10**18 + row * 10**8, row, b"%05d" % row)
                writer.vehicle(10**18 + row * 10**8, row, VehicleState(steering=0.1))
    with pytest.raises(DatasetError, match="the same picture in both") as refused:
        build_index(find_logs((), tmp_path), tmp_path / "index", BLOCKS)
    assert ("`bc-record --seed N` gives another drive" in str(refused.value)) == is_hinted


def test_two_sessions_of_one_name_are_refused(tmp_path: Path) -> None:
    for place in ("here", "there"):
        write_log(tmp_path / place / "lake.mcap", [0.0])
    given_twice = str(tmp_path / "here" / "lake.mcap")
    with pytest.raises(DatasetError, match="two sessions with the same name"):
        find_logs((given_twice, str(tmp_path / "there" / "lake.mcap")), tmp_path)
    assert find_logs((given_twice, "lake"), tmp_path / "here") == [Path(given_twice)]
    with pytest.raises(DatasetError, match="two sessions with the same name"):
        build_index([tmp_path / "here" / "lake.mcap", tmp_path / "there" / "lake.mcap"], tmp_path / "index")
    assert not (tmp_path / "index").exists()


def test_bc_index_prints_sessions_balance_and_totals(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    write_log(tmp_path / "lake.mcap", STEERING)
    line = ["--sessions", tmp_path, "--index", tmp_path / "index", "--block-s", 2]
    assert call(main, *line) == 0
    output = capsys.readouterr().out.splitlines()
    samples = rows_of(tmp_path / "index" / "samples.parquet")
    split = Counter(row["split"] for row in samples)
    assert output[-1].startswith(f"{tmp_path / 'index'}: 900 frames, {len(samples):,} samples")
    assert f"{split['train']:,} train" in output[-1]
    assert f"{split['validation']:,} validation" in output[-1]
    (session,) = [text.split() for text in output if text.startswith("lake ") and "read" in text]
    frames = Counter(row["split"] for row in rows_of(tmp_path / "index" / "frames" / "lake.parquet"))
    counted = [frames["train"], frames["validation"], frames["gap"]]
    assert session == ["lake", "900", *map(str, counted), "0", "read"]
    assert sum("0.00 .. 0.04" in text for text in output) == 1
    assert call(main, *line) == 0
    assert "unchanged" in capsys.readouterr().out


def test_bc_index_without_sessions_reports_what_to_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(main, "--sessions", tmp_path / "none", "--index", tmp_path / "index") == 1
    output = capsys.readouterr()
    assert output.out == ""
    assert len(output.err.splitlines()) == 1
    assert "bc-record" in output.err
    assert not (tmp_path / "index").exists()
