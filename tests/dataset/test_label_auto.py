"""What an index makes of the labels of each session by itself, and how it says so."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from common.stored_settings import settings_from
from dataset import IndexConfig, Indexed, Samples, build_index
from dataset.cli import main
from dataset.index.build_state import stat_of
from dataset.samples.samples_format import not_learnt_in
from recorder import Log
from recorder.log_cli import main as bc_log
from tests.helpers.bucket import Bucket
from tests.helpers.bytes_read import count_bytes, note_reads
from tests.helpers.logs import write_log
from tests.helpers.panorama import hand, of_size, pressed, views, write_drive
from tests.helpers.udacity import call

ROWS = 650  # of 65 s
NO_PICTURES = [f"{row}".encode() for row in range(ROWS)]


def keys(at_s: np.ndarray) -> np.ndarray:
    """A key for half of each second, left and right."""
    return np.asarray(np.where(at_s % 1 < 0.5, np.where(at_s % 2 < 1, 0.6, -0.6), 0.0))


def indexed(folder: Path, *logs: Path, **settings: Any) -> Indexed:
    config: Any = {"flip": False, "balance": False, "block_s": 5.0, "gap_s": 0.0, **settings}
    return build_index(logs, folder / "index", IndexConfig(**config))


def label_and_recorded(indexed: Indexed) -> tuple[np.ndarray, np.ndarray]:
    samples = indexed.samples
    return samples["label"].to_numpy(), samples["recorded"].to_numpy()


def metadata(indexed: Indexed) -> dict[str, Any]:
    stored: dict[str, Any] = json.loads(pq.read_schema(indexed.path / "samples.parquet").metadata[b"bc.index"])
    return stored


def test_keys_are_learnt_as_with_the_flags_that_suit_them(tmp_path: Path) -> None:
    log = write_drive(tmp_path / "a.mcap", NO_PICTURES, keys)
    automatic = indexed(tmp_path, log)
    label, recorded = label_and_recorded(automatic)
    assert not np.array_equal(label, recorded)
    plan = metadata(automatic)["labels"]["a"]["plan"]
    assert (plan["smooth_s"], plan["shift_s"], plan["without_crashes"]) == (0.5, 0.2, True)
    given = indexed(tmp_path, log, labels="as-recorded", label_smooth_s=0.5, label_shift_s=0.2)
    assert automatic.samples.equals(given.samples)


def test_seconds_that_are_given_hold_for_every_session(tmp_path: Path) -> None:
    logs = [
        write_drive(tmp_path / "a.mcap", NO_PICTURES, keys),
        write_drive(tmp_path / "b.mcap", NO_PICTURES[::-1], driver="expert"),
    ]
    plans = metadata(indexed(tmp_path, *logs, label_shift_s=0.4))["labels"]
    assert [(plans[name]["plan"]["smooth_s"], plans[name]["plan"]["shift_s"]) for name in "ab"] == [
        (0.5, 0.4),
        (0.0, 0.4),
    ]


@pytest.mark.parametrize("late_s", [0.3, -0.7])
def test_a_smooth_hand_is_learnt_as_recorded_whatever_pictures_show(late_s: float, tmp_path: Path) -> None:
    log = write_drive(tmp_path / "a.mcap", views(ROWS), lambda at_s: hand(at_s - late_s))
    index = indexed(tmp_path, log)
    labels = metadata(index)["labels"]["a"]
    assert labels["lag"]["lag_s"] == pytest.approx(late_s, abs=labels["lag"]["margin_s"] + 1e-9)
    label, recorded = label_and_recorded(index)
    assert np.array_equal(label, recorded)


@pytest.mark.parametrize(("late_s", "shift_s"), [(0.0, 0.2), (0.3, 0.6), (-0.7, 0.2), (0.7, 0.2)])
def test_presses_are_shifted_more_where_their_record_is_late(
    late_s: float, shift_s: float, tmp_path: Path
) -> None:
    log = write_drive(tmp_path / "a.mcap", views(ROWS), lambda at_s: pressed(at_s - late_s))
    plan = metadata(indexed(tmp_path, log))["labels"]["a"]["plan"]
    assert plan["smooth_s"] == 0.5
    assert plan["shift_s"] == pytest.approx(shift_s, abs=0.051)


def replace_samples(index: Indexed, samples: pa.Table, stored: dict[str, Any]) -> None:
    """As the version that wrote them would have left the index."""
    file = index.path / "samples.parquet"
    pq.write_table(samples.replace_schema_metadata({b"bc.index": json.dumps(stored).encode()}), file)
    state = json.loads((index.path / "state.json").read_text())
    state["samples"] = list(stat_of(file) or ())
    (index.path / "state.json").write_text(json.dumps(state))


def test_the_built_in_expert_is_learnt_as_recorded_without_pictures(
    tmp_path: Path,
) -> None:
    """Its pictures would say that it is late; and no rows are left out."""
    speed = lambda at_s: np.where((at_s > 30) & (at_s < 35), 0.1, 20.0)  # noqa: E731
    log = write_drive(tmp_path / "a.mcap", views(ROWS), lambda at_s: hand(at_s - 0.5), speed, driver="expert")
    automatic = indexed(tmp_path, log)
    stored = metadata(automatic)
    assert stored["labels"]["a"]["lag"] is None
    as_recorded = indexed(tmp_path, log, labels="as-recorded")
    assert automatic.samples.equals(as_recorded.samples)
    assert metadata(as_recorded)["balance"] == stored["balance"]


def test_the_next_index_reads_a_hundredth_of_a_log_and_no_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = write_drive(tmp_path / "a.mcap", of_size(views(ROWS), 15_000), lambda at_s: pressed(at_s - 0.3))
    with Log(log) as opened:
        images = {number for number, channel in opened.channels.items() if channel.topic.startswith("/camera/")}
        pictures = [(chunk.start, chunk.end) for chunk in opened.chunks if (chunk.channels or set()) & images]
    first = metadata(indexed(tmp_path, log))["labels"]["a"]
    assert json.loads((tmp_path / "a.lag.json").read_text())["lag"] == first["lag"]
    shutil.rmtree(tmp_path / "index")
    read = note_reads(monkeypatch)
    again = metadata(indexed(tmp_path, log))["labels"]["a"]
    assert again == first
    plan = again["plan"]
    assert plan["shift_s"] == pytest.approx(0.6, abs=0.051)
    assert 0 < count_bytes(read) < 0.03 * log.stat().st_size
    assert not [part for part in read if any(start < part[1] and part[0] < end for start, end in pictures)]


def test_the_index_of_a_bucket_moves_a_hundredth_of_its_logs(bucket: Bucket) -> None:
    new, old = (
        write_drive(folder / f"{name}.mcap", of_size(views(ROWS), 15_000), pressed, start_s=start_s)
        for name, folder, start_s in (("new", Path(), 0), ("old", bucket.folder, 1000))
    )
    assert call(bc_log, "copy", new, bucket.url()) == 0  # with its lag
    size, before = new.stat().st_size + old.stat().st_size, bucket.bytes_sent
    settings = ("--sessions", bucket.url(), "--index", "index")
    assert call(main, *settings) == 0
    assert 0 < bucket.bytes_sent - before < 0.03 * size
    assert call(bc_log, "check", bucket.url("old.mcap")) == 0
    before = bucket.bytes_sent
    assert call(main, *settings) == 0  # goes by what is kept in the bucket
    assert bucket.bytes_sent - before < 0.03 * size
    labels = json.loads(pq.read_schema("index/samples.parquet").metadata[b"bc.index"])["labels"]
    assert [labels[name]["lag"]["lag_s"] for name in ("new", "old")] == pytest.approx([0, 0], abs=0.051)


@pytest.mark.parametrize("is_kept_beside", [True, False])
@pytest.mark.parametrize("look", [(), ("--look",)])
def test_a_late_session_is_named_and_shifted(
    is_kept_beside: bool, look: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where nothing can be written beside the log, the index keeps the lag."""
    folder = tmp_path / "sessions"
    folder.mkdir()
    write_drive(folder / "a.mcap", views(ROWS), lambda at_s: pressed(at_s - 0.3))
    if not is_kept_beside:
        (folder / "a.lag.json").mkdir()
    assert call(main, "--sessions", folder, "--index", tmp_path / "index", *look) == 0
    assert "is 0.4 s late" in " ".join(capsys.readouterr().out.split())
    assert (folder / "a.lag.json").is_file() == is_kept_beside
    stored = json.loads(pq.read_schema(tmp_path / "index" / "samples.parquet").metadata[b"bc.index"])
    assert stored["labels"]["a"]["plan"]["shift_s"] == pytest.approx(0.6, abs=0.051)


def crashing(at_s: np.ndarray) -> np.ndarray:
    """At 30 s and at 50 s the car hits something, and needs four seconds to get away."""
    return np.asarray(np.where((at_s % 20 >= 10) & (at_s % 20 < 14) & (at_s > 29), 0.2, 25.0))


def test_crashes_are_neither_learnt_nor_held_out(tmp_path: Path) -> None:
    at_the_wall = lambda at_s: np.where(crashing(at_s) < 1, 1.0, keys(at_s))  # noqa: E731
    log = write_drive(tmp_path / "a.mcap", NO_PICTURES, at_the_wall, crashing)
    crash = {*range(300, 340), *range(500, 540)}
    # the second one is held out: blocks of 5 s, chosen by the session's name
    learnt = indexed(tmp_path, log, validation_share=0.5, seed=1)
    frames = learnt.frames.to_pylist()
    assert {row["row"] for row in frames if "crash" in row["flags"]} == crash
    split = {row["row"]: row["split"] for row in frames}
    assert {split[row] for row in crash} == {"train", "validation"}
    about = {
        row["row"] for row in frames if "manoeuvring" in row["flags"]
    }  # a second before it, and a turned wheel
    assert {*range(291, 300), *range(491, 500)} <= about <= {*range(290, 370), *range(490, 570)} - crash
    samples = {row["row"]: row for row in learnt.samples.to_pylist()}
    assert not (crash | about) & samples.keys()
    assert max(abs(row["label"]) for row in samples.values()) <= 0.6 + 1e-9
    sides = Counter(split[row] for row in crash | about)
    assert learnt.counts["a"].not_driven == sides["train"] + sides["validation"]
    assert learnt.counts["a"].not_measured == sides["validation"] > 0
    everything = indexed(tmp_path, log, validation_share=0.5, seed=1, labels="as-recorded")
    assert {row["row"] for row in everything.samples.to_pylist()} == set(range(ROWS))
    assert everything.counts["a"].not_driven == 0


def test_an_index_of_an_earlier_version_is_read_as_recorded_and_rebuilt(tmp_path: Path) -> None:
    log = write_drive(tmp_path / "a.mcap", NO_PICTURES, keys)
    index = indexed(tmp_path, log, labels="as-recorded")
    before = index.samples
    file = index.path / "samples.parquet"
    stored = metadata(index)
    settings = stored["settings"]
    del settings["labels"], stored["labels"], stored["counts"]["a"]["crashed"]
    settings |= {"label_smooth_s": 0.0, "label_shift_s": 0.0}
    pq.write_table(before.replace_schema_metadata({b"bc.index": json.dumps(stored).encode()}), file)
    with Samples(index.path) as samples:
        assert samples.table.equals(before)
    config = settings_from(IndexConfig, settings)
    assert (config.labels, config.label_smooth_s, config.label_shift_s) == ("as-recorded", 0, 0)
    assert build_index([log], tmp_path / "again", config).samples.equals(before)
    assert not indexed(tmp_path, log).samples.equals(before)
    assert metadata(index)["settings"]["labels"] == "auto"


def test_an_index_that_held_out_crashes_is_read_and_made_anew(tmp_path: Path) -> None:
    log = write_drive(tmp_path / "a.mcap", NO_PICTURES, keys, crashing)
    index = indexed(tmp_path, log)
    stored, now = metadata(index), index.samples
    assert not_learnt_in(index.path)[0].startswith("neither learnt nor held out: a (")
    del stored["counts"]["a"]["not_measured"]
    replace_samples(index, now.slice(1), stored)
    with Samples(index.path) as samples:
        assert len(samples.table) == len(now) - 1
    (line,) = not_learnt_in(index.path)
    assert line.endswith("`bc-index` leaves these out")
    assert indexed(tmp_path, log).samples.equals(now)
    stored["labels"]["a"]["plan"]["without_crashes"] = False  # an expert's: nothing was to be left out
    replace_samples(index, now, stored)
    assert not_learnt_in(index.path)[0].startswith("neither learnt nor held out: a (")


# What is said of it


def test_the_command_reports_how_each_session_was_steered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "sessions"
    folder.mkdir()
    write_drive(folder / "keyboard.mcap", NO_PICTURES, keys)
    write_drive(folder / "late.mcap", views(ROWS), lambda at_s: pressed(at_s - 0.3))
    write_log(folder / "short.mcap", [0.1, 0.2] * 30)
    write_drive(folder / "mirrored.mcap", views(ROWS)[1:], lambda at_s: -hand(at_s + 0.1))
    for _ in ("built", "found built"):
        assert call(main, "--sessions", folder, "--index", tmp_path / "index") == 0
        printed = " ".join(capsys.readouterr().out.split())
        assert "keyboard keys 50% 65 x 0.5 s 10.0" in printed
        for word in ("mean of 0.5 s", "is 0.4 s late", "+0.30 ±0.05", "too short to tell", "is left right?"):
            assert word in printed
