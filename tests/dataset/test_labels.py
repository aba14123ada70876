"""Labels of people: steering that is smoothed, or taken a little later, and what it may never depend on."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dataset import IndexConfig, Indexed, Samples, build_index
from dataset.cli import main
from dataset.samples.labels import labels_of
from dataset.steering_bins import bin_of
from recorder import Log, LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log.tags import Tag, add_tags
from tests.helpers.logs import write_log
from tests.helpers.udacity import call

MS = 1_000_000  # ns


@dataclass(frozen=True)
class Row:
    """A row of a session as its frames tell it."""

    step_ms: int  # since the row before
    steering: float
    split: int = 0
    is_in_range: bool = True
    new_drive: bool = False
    cameras: int = 1
    broken: int = 0  # pictures of the first cameras

    @property
    def is_usable(self) -> bool:
        return self.is_in_range and self.broken < self.cameras


rows_of_people = st.lists(
    st.builds(
        Row,
        step_ms=st.sampled_from([50, 66, 100, 100, 100, 0, 999, 1000, 1001, -300]),
        steering=st.floats(-1, 1),
        split=st.sampled_from([0, 0, 0, 0, 0, 0, 1, 2]),
        is_in_range=st.sampled_from([True] * 9 + [False]),
        new_drive=st.sampled_from([False] * 19 + [True]),
        cameras=st.integers(1, 3),
        broken=st.sampled_from([0] * 9 + [1]),
    ),
    min_size=1,
    max_size=40,
)
smooths = st.sampled_from([0.0, 0.1, 0.132, 0.5, 2.0, 60.0])
shifts = st.sampled_from([0.0, 0.1, 0.1, 0.25, 1.0, -0.1, -0.33])


def times_ms(rows: list[Row]) -> list[int]:
    return [sum(row.step_ms for row in rows[1 : i + 1]) for i in range(len(rows))]


def labels(rows: list[Row], smooth_s: float, shift_s: float, order: list[int] | None = None) -> list[float | None]:
    """What the toolkit says for each row; all of its cameras must agree. `order` shuffles the frames."""
    pictures = [(number, i) for number, row in enumerate(rows) for i in range(row.cameras)]
    pictures = [pictures[at] for at in order or range(len(pictures))]
    frames = [number for number, _ in pictures]
    is_usable = [rows[number].is_in_range and i >= rows[number].broken for number, i in pictures]
    split = [rows[number].split for number in frames]
    drive = np.cumsum([row.new_drive for row in rows])
    table = pa.table(
        {
            "row": np.array(frames),
            "log_time_ns": np.array(times_ms(rows))[frames] * MS + 10**18,
            "drive": drive[frames],
            "steering": np.array([row.steering if row.is_in_range else np.nan for row in rows])[frames],
        }
    )
    values_of_frames = labels_of(table, np.array(is_usable), np.array(split, np.int8), smooth_s, shift_s)
    of_row = [
        {float(value) for value in values_of_frames[np.array(frames) == number]} for number in range(len(rows))
    ]
    assert all(len(values) == 1 or all(np.isnan(value) for value in values) for values in of_row)
    return [None if np.isnan(value := values.pop()) else value for values in of_row]


def stretch_of(rows: list[Row], at: int) -> list[int]:
    """The rows without a border between them and this one."""

    def is_linked(a: Row, b: Row) -> bool:
        is_next = 0 <= b.step_ms <= 1000 and not b.new_drive
        return is_next and a.split == b.split and a.is_usable and b.is_usable

    first = last = at
    while first > 0 and is_linked(rows[first - 1], rows[first]):
        first -= 1
    while last + 1 < len(rows) and is_linked(rows[last], rows[last + 1]):
        last += 1
    return list(range(first, last + 1))


def truth(rows: list[Row], smooth_s: float, shift_s: float) -> list[float | None]:
    """The same by the words of the documentation, slowly and exactly."""
    time_ms = [Fraction(time) for time in times_ms(rows)]

    def smoothed(at: int) -> Fraction:
        near = [i for i in stretch_of(rows, at) if abs(time_ms[i] - time_ms[at]) <= Fraction(str(smooth_s)) * 500]
        values = [Fraction(rows[i].steering) for i in near]
        return sum(values, Fraction()) / len(values) if smooth_s else Fraction(rows[at].steering)

    def label(at: int) -> float | None:
        wanted = time_ms[at] + Fraction(str(shift_s)) * 1000
        stretch = stretch_of(rows, at)
        if not rows[at].is_usable or not time_ms[stretch[0]] <= wanted <= time_ms[stretch[-1]]:
            return None
        if not shift_s:
            return float(smoothed(at))
        after = next(i for i in stretch if time_ms[i] >= wanted)
        if time_ms[after] == wanted:
            return float(smoothed(after))
        share = (wanted - time_ms[after - 1]) / (time_ms[after] - time_ms[after - 1])
        return float((1 - share) * smoothed(after - 1) + share * smoothed(after))

    return [label(at) for at in range(len(rows))]


# What holds for any drive


@given(rows_of_people, smooths, shifts, st.randoms(use_true_random=False))
def test_labels_are_those_of_a_slow_and_exact_computation(
    rows: list[Row], smooth_s: float, shift_s: float, random: Any
) -> None:
    order = list(range(sum(row.cameras for row in rows)))
    random.shuffle(order)
    expected = truth(rows, smooth_s, shift_s)
    if not smooth_s and not shift_s:
        expected = [row.steering if row.is_in_range else None for row in rows]
    values = labels(rows, smooth_s, shift_s, order)
    assert [value is None for value in values] == [value is None for value in expected]
    assert [value for value in values if value is not None] == pytest.approx(
        [value for value in expected if value is not None], abs=1e-11
    )


@given(rows_of_people, smooths, shifts)
def test_a_label_is_never_beyond_the_steering_of_its_stretch(
    rows: list[Row], smooth_s: float, shift_s: float
) -> None:
    for at, value in enumerate(labels(rows, smooth_s, shift_s)):
        if value is not None:
            steering = [rows[i].steering for i in stretch_of(rows, at)]
            assert min(steering) - 1e-15 <= value <= max(steering) + 1e-15


@given(rows_of_people, smooths, shifts)
def test_a_mirrored_drive_has_the_negative_labels(rows: list[Row], smooth_s: float, shift_s: float) -> None:
    mirrored = labels([replace(row, steering=-row.steering) for row in rows], smooth_s, shift_s)
    assert mirrored == [value if value is None else -value for value in labels(rows, smooth_s, shift_s)]


def test_a_ramp_is_shifted_exactly_and_smoothing_does_not_bend_it() -> None:
    ramp = [Row(step_ms=50, steering=row / 64) for row in range(64)]  # binary fractions
    assert labels(ramp, 0, 0.2) == [*(row / 64 for row in range(4, 64)), *[None] * 4]
    assert labels(ramp, 0, 0.075) == [*((row + 1.5) / 64 for row in range(62)), None, None]
    assert labels(ramp, 0, -0.05) == [None, *(row / 64 for row in range(63))]
    smoothed = labels(ramp, 0.4, 0)  # four rows on either side
    assert smoothed[4:-4] == [row / 64 for row in range(4, 60)]
    assert (smoothed[0], smoothed[-1]) == (2 / 64, 61 / 64)  # the window is cut at the edge


# From a log to its samples

STEERING = [round(0.3 + 0.005 * row, 3) for row in range(100)]


def indexed(tmp_path: Path, **settings: Any) -> Indexed:
    """The index of a session, a row every tenth of a second."""
    log = tmp_path / "a.mcap"
    if not log.exists():
        write_log(log, STEERING)
    config: Any = {"balance": False, "validation_share": 0.0, **settings}
    return build_index([log], tmp_path / "index", IndexConfig(**config))


def straight(samples: pa.Table, column: str = "label", camera: str = "center") -> dict[int, float]:
    return {row["row"]: row[column] for row in samples.to_pylist() if row["camera"] == camera and not row["flip"]}


def test_labels_are_corrected_mirrored_and_binned_after_they_were_treated(tmp_path: Path) -> None:
    index = indexed(tmp_path, label_smooth_s=0.4, label_shift_s=0.35, bins=15)
    for row in index.samples.to_pylist():
        correction, sign = {"center": 0, "left": 0.2, "right": -0.2}[row["camera"]], -1 if row["flip"] else 1
        assert row["recorded"] == pytest.approx(sign * min(STEERING[row["row"]] + correction, 1), abs=1e-12)
        if 2 <= row["row"] < 94:  # elsewhere the window is cut
            expected = sign * min(STEERING[row["row"]] + 3.5 * 0.005 + correction, 1)
            assert row["label"] == pytest.approx(expected, abs=1e-11)
        assert row["bin"] == bin_of(np.array([row["label"]]), 15)[0]
    assert sorted(straight(index.samples)) == list(range(96))
    assert index.balance.before.tolist() == np.bincount(index.samples["bin"].to_numpy(), minlength=15).tolist()
    counts = index.counts["a"]
    assert (counts.frames, counts.training, counts.unlabelled) == (300, 288, 12)


def test_no_label_is_from_the_other_side_of_the_split(tmp_path: Path) -> None:
    settings: dict[str, Any] = {
        "validation_share": 0.3,
        "block_s": 1.0,
        "gap_s": 0.2,
        "label_smooth_s": 1.0,
        "label_shift_s": 0.3,
    }
    index = indexed(tmp_path, **settings)
    split = {row["row"]: row["split"] for row in index.frames.to_pylist()}
    edges = {row for row in range(97) if len({split[row + i] for i in range(4)}) > 1} | {97, 98, 99}
    assert len(edges) > 10
    assert straight(index.samples).keys() == {row for row in range(100) if split[row] != "gap"} - edges
    before = straight(index.samples)
    for other in ("train", "validation"):
        changed = [-value if split[row] != other else value for row, value in enumerate(STEERING)]
        write_log(tmp_path / "a.mcap", changed, overwrite=True)
        after = straight(indexed(tmp_path, **settings).samples)
        assert {row: after[row] == before[row] for row in before} == {row: split[row] == other for row in before}


def test_validation_compares_treated_labels_with_the_recorded_ones(tmp_path: Path) -> None:
    index = indexed(tmp_path, validation_share=0.3, block_s=1.0, label_shift_s=0.2)
    with Samples(index.path) as samples:
        table, seen = samples.of_split("validation"), samples.driving_view("validation")
    held_out = straight(table)
    assert held_out == pytest.approx({row: STEERING[row + 2] for row in held_out})
    assert straight(seen) == {row: STEERING[row] for row in held_out}


def test_an_excluded_row_is_an_edge_and_a_condition_is_none(tmp_path: Path) -> None:
    log = write_log(tmp_path / "a.mcap", STEERING)
    with Log(log) as opened:
        add_tags(log, opened.fingerprint, [Tag(50, 52, "exclude")])
    index = indexed(tmp_path, where="row % 2 = 1", label_shift_s=0.2)
    rows = {row for row in range(1, 98, 2) if row not in (49, 51)}
    assert straight(index.samples) == pytest.approx({row: STEERING[row + 2] for row in rows})
    counts = index.counts["a"]
    assert (counts.unlabelled, counts.excluded) == (6, 3)  # rows 49 and 99; row 51


def test_steering_out_of_range_and_a_gap_in_time_are_edges(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.mcap", {"source": "test"}) as writer:
        for row, value in enumerate(STEERING):
            time_ns = 10**18 + row * 100 * MS + (5000 * MS if row >= 70 else 0)
            writer.picture("center", time_ns, row, b"%d" % row)
            writer.vehicle(time_ns, row, VehicleState(steering=float("nan") if row == 30 else value))
    index = indexed(tmp_path, label_shift_s=0.1)
    assert straight(index.samples).keys() == set(range(100)) - {29, 30, 69, 99}
    assert (index.counts["a"].unlabelled, index.counts["a"].unusable) == (3, 1)


def test_an_index_of_other_labels_is_built_again_with_another_fingerprint(tmp_path: Path) -> None:
    def fingerprint() -> str:
        with Samples(tmp_path / "index") as samples:
            return samples.fingerprint

    seen = []
    choices: list[dict[str, Any]] = [{}, {"label_smooth_s": 0.4}, {"label_shift_s": 0.1}]
    for settings in choices:
        index = indexed(tmp_path, **settings)
        stored = json.loads(pq.read_schema(index.path / "samples.parquet").metadata[b"bc.index"])["settings"]
        assert stored.items() >= settings.items()
        seen.append(fingerprint())
    assert indexed(tmp_path).read == []  # no log is read again for it
    assert fingerprint() == seen[0]
    assert len(set(seen)) == 3


# The command


def run(tmp_path: Path, *flags: object) -> int:
    write_log(tmp_path / "sessions" / "a.mcap", STEERING, overwrite=True)
    return call(main, "--sessions", tmp_path / "sessions", "--index", tmp_path / "index", *flags)


def test_the_command_shows_how_many_frames_have_no_label(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "sessions").mkdir()
    flags = ("--no-balance", "--validation-share", 0)
    assert run(tmp_path, *flags, "--label-smooth", 0.5, "--label-shift", 0.2) == 0
    shown = capsys.readouterr().out
    assert "no label" in shown
    assert ["a", "300", "294", "0", "0", "0", "6", "read"] in [line.split() for line in shown.splitlines()]
    stored = json.loads(pq.read_schema(tmp_path / "index" / "samples.parquet").metadata[b"bc.index"])
    assert (stored["settings"]["label_smooth_s"], stored["settings"]["label_shift_s"]) == (0.5, 0.2)
    assert run(tmp_path, *flags) == 0
    assert "no label" not in capsys.readouterr().out


def test_a_shift_longer_than_every_stretch_leaves_nothing_and_reports_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "sessions").mkdir()
    assert run(tmp_path, "--label-shift", 10) == 1
    assert "no frame can be used" in (printed := capsys.readouterr().err)
    assert "--label-shift" in printed
