"""The flags of frames, which of them cannot be used, and the report of their stretches."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.car import CAMERAS, Camera
from dataset import DatasetError
from dataset.frames.frame_flags import FRAME_FLAGS, ImageFindings, Paired, frame_flags, is_unusable
from dataset.index.quality_report import FlaggedFrames, find_flagged_frames, print_quality_report
from recorder.rows.row_quality import States

STEP_NS = 100_000_000
START_NS = int(datetime(2024, 7, 13, 14, 30, 16, tzinfo=UTC).timestamp()) * 10**9
NOTHING_FOUND = ImageFindings(0, {}, {})


def states(rows: int, **columns: Any) -> States:
    """A drive without anything odd, but for the columns given."""
    told = {
        "row": np.arange(rows),
        "time_ns": START_NS + np.arange(rows) * STEP_NS,
        "steering": np.arange(rows) / rows,
        "throttle": np.full(rows, 0.5),
        "brake": np.zeros(rows),
        "speed_mph": np.full(rows, 9.0),
        **{name: np.asarray(column) for name, column in columns.items()},
    }
    return States(**told)


def every(rows: int) -> Paired:
    return Paired(np.arange(rows), np.arange(rows))


def only(*rows: int) -> Paired:
    """A camera with pictures of these rows only."""
    return Paired(np.array(rows, np.int64), np.arange(len(rows)))


# The flags


def test_a_row_without_anything_odd_has_no_flag() -> None:
    frames: dict[Camera, Paired] = {camera: every(4) for camera in CAMERAS}
    column = frame_flags(states(4), frames, NOTHING_FOUND)
    assert column.type == pa.list_(pa.string())
    assert column.to_pylist() == [[]] * 12


def test_what_a_row_has_every_frame_of_it_has() -> None:
    time_ns = START_NS + np.array([0, 1, 2, 50, 51]) * STEP_NS
    odd = states(5, time_ns=time_ns, steering=[0.1, 1.5, 0.3, 0.4, np.nan], speed_mph=[9, 0, np.nan, 0.4, 0.6])
    of_rows = [[], ["out_of_range", "standing_still"], [], ["gap", "standing_still"], ["out_of_range"]]
    frames: dict[Camera, Paired] = {"center": every(5), "right": every(5)}
    assert frame_flags(odd, frames, None).to_pylist() == of_rows + of_rows


def test_stuck_steering_is_a_flag_of_its_frames() -> None:
    held = [0.25] * 40 + [0.5, 0.6]  # four seconds of the very same steering
    assert frame_flags(states(42, steering=held), {"center": every(42)}, None).to_pylist() == [
        *[["stuck_steering"]] * 40,
        [],
        [],
    ]


def test_a_missing_picture_is_a_flag_of_the_other_pictures_of_its_row() -> None:
    frames: dict[Camera, Paired] = {"center": only(0, 1, 2, 3), "left": only(0, 2, 3), "right": only()}
    flags = frame_flags(states(5), frames, None).to_pylist()
    assert flags == [[], ["missing_picture"], [], [], [], [], []]  # nobody expects the right camera
    frames["right"] = only(4)
    assert frame_flags(states(5), frames, None).to_pylist() == [["missing_picture"]] * 8


def test_pictures_are_flagged_by_their_place_among_those_of_their_camera() -> None:
    """A picture without a vehicle state is no frame, but it counts in what was looked at."""
    frames: dict[Camera, Paired] = {
        "center": Paired(np.array([0, 1, 2, 3]), np.array([0, 2, 3, 5])),
        "left": Paired(np.array([0, 1, 2, 3]), np.array([3, 2, 1, 0])),
    }
    looked = ImageFindings(10, {"center": ((1, 2), (5, 9))}, {"center": ((2, 4),), "left": ((0, 1), (2, 2))})
    assert frame_flags(states(4), frames, looked).to_pylist() == [
        *([], ["broken_picture", "frozen_picture"], ["frozen_picture"], ["broken_picture"]),
        *([], ["frozen_picture"], ["frozen_picture"], ["frozen_picture"]),
    ]


masks = st.lists(st.lists(st.booleans(), min_size=3, max_size=3), max_size=30)


@given(masks)
def test_lists_hold_each_flag_of_their_frame_once_and_in_one_order(odd: list[list[bool]]) -> None:
    rows = len(odd)
    standing, wrong, broken = np.array(odd, np.bool_).reshape(rows, 3).T
    told = states(rows, speed_mph=np.where(standing, 0.0, 5.0), throttle=np.where(wrong, 7.0, 0.5))
    looked = ImageFindings(rows, {"center": tuple((int(at), int(at)) for at in np.flatnonzero(broken))}, {})
    in_order: list[str] = list(FRAME_FLAGS)
    names = ("standing_still", "out_of_range", "broken_picture")
    assert frame_flags(told, {"center": every(rows)}, looked).to_pylist() == [
        sorted((name for name, holds in zip(names, row, strict=True) if holds), key=in_order.index) for row in odd
    ]


def test_only_steering_out_of_range_and_broken_pictures_cannot_be_used() -> None:
    told = ["gap", "frozen_picture", "missing_picture", "stuck_steering", "standing_still"]
    flags = [["out_of_range"], ["out_of_range"], ["broken_picture"], told, []]
    table = pa.table({"bin": [-1, 12, 3, 4, 5], "flags": pa.array(flags, pa.list_(pa.string()))})
    assert is_unusable(table).tolist() == [True, False, True, False, False]  # the second one's pedals are
    twice = pa.concat_tables([table, table])
    assert is_unusable(twice).tolist() == is_unusable(table).tolist() * 2


# The report


def write_frames(
    index: Path, session: str, flags: list[list[str]], *, encoded: bool = False, **columns: list[int]
) -> None:
    """One frame for each list of flags, in rows a tenth of a second apart, but for the columns given."""
    rows = len(flags)
    path = index / "frames" / f"{session}.parquet"
    path.parent.mkdir(parents=True, exist_ok=True)
    row = np.array(columns.get("row", list(range(rows))), np.int64)
    time_ns = np.array(columns.get("time_ns", (START_NS + row * STEP_NS).tolist()), np.int64)
    names = pa.array([session] * rows, pa.string())
    lists = pa.array(flags, pa.list_(pa.string()))
    if encoded:
        names = names.dictionary_encode()
        lists = pa.ListArray.from_arrays(lists.offsets, lists.flatten().dictionary_encode())
    pq.write_table(pa.table({"session": names, "row": row, "log_time_ns": time_ns, "flags": lists}), path)


@pytest.mark.parametrize("encoded", [False, True])
def test_neighbouring_rows_with_a_flag_are_one_stretch(tmp_path: Path, encoded: bool) -> None:
    standing, both = ["standing_still"], ["standing_still", "frozen_picture"]
    write_frames(tmp_path, "b", [[], standing, both, both, [], standing], encoded=encoded)
    write_frames(tmp_path, "a", [["out_of_range"], []], encoded=encoded)
    write_frames(tmp_path, "quiet", [[], []], encoded=encoded)
    write_frames(tmp_path, "empty", [], encoded=encoded)
    assert find_flagged_frames(tmp_path) == [
        FlaggedFrames("a", "out_of_range", 0, 0, 0.0, 0.0, "2024-07-13T14:30:16.000+00:00", 1, 1),
        FlaggedFrames("b", "standing_still", 1, 3, 0.1, 0.3, "2024-07-13T14:30:16.100+00:00", 3, 3),
        FlaggedFrames("b", "frozen_picture", 2, 3, 0.2, 0.3, "2024-07-13T14:30:16.200+00:00", 2, 2),
        FlaggedFrames("b", "standing_still", 5, 5, 0.5, 0.5, "2024-07-13T14:30:16.500+00:00", 1, 1),
    ]


def test_cameras_of_a_moment_are_one_row_and_late_ones_change_nothing(tmp_path: Path) -> None:
    rows = [7, 7, 7, 8, 8, 10, 10, 10, 8]  # the last picture came late
    flags = [["frozen_picture"], [], [], ["frozen_picture"], [], ["frozen_picture"], [], [], ["frozen_picture"]]
    write_frames(tmp_path, "a", flags, row=rows)
    [one] = find_flagged_frames(tmp_path)
    assert (one.first_row, one.last_row, one.frames, one.rows) == (7, 10, 4, 3)
    assert (one.begin_s, one.end_s) == (0.0, 0.3)


def test_a_gap_begins_at_the_row_before_it(tmp_path: Path) -> None:
    time_ns = [START_NS + tenths * STEP_NS for tenths in (0, 1, 91, 92)]
    write_frames(tmp_path, "a", [[], [], ["gap"], []], time_ns=time_ns)
    assert find_flagged_frames(tmp_path) == [
        FlaggedFrames("a", "gap", 2, 2, 0.1, 9.1, "2024-07-13T14:30:16.100+00:00", 1, 1)
    ]


def test_times_of_any_log_can_be_told(tmp_path: Path) -> None:
    write_frames(tmp_path, "a", [["gap"], ["gap"]], time_ns=[-(2**63), 2**63 - 1])
    [one] = find_flagged_frames(tmp_path)
    assert one.begin_utc == "1677-09-21T00:12:43.145+00:00"
    assert one.end_s == pytest.approx(2**64 / 1e9)


def test_the_report_of_frames_agrees_with_a_count_row_by_row(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    rows = 500
    drawn = random.random((rows, 2)) < 0.4
    write_frames(tmp_path, "a", [[n for n, holds in zip("xy", row, strict=True) if holds] for row in drawn])
    covered = np.zeros((rows, 2), np.bool_)
    for one in find_flagged_frames(tmp_path):
        which = "xy".index(one.flag)
        assert one.frames == one.last_row - one.first_row + 1
        assert not covered[one.first_row : one.last_row + 1, which].any()
        covered[one.first_row : one.last_row + 1, which] = True
    assert (covered == drawn).all()


def test_an_index_that_is_missing_or_damaged_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no index; build it with `bc-index`"):
        find_flagged_frames(tmp_path)
    (tmp_path / "frames").mkdir()
    path = tmp_path / "frames" / "a.parquet"
    for table in (
        pa.table({"row": [1]}),
        pa.table({"session": ["a"], "row": [None], "log_time_ns": [1], "flags": [["gap"]]}),
        pa.table({"session": ["a"], "row": [1], "log_time_ns": [1], "flags": ["gap"]}),
        pa.table({"session": ["a"], "row": [1], "log_time_ns": [1], "flags": [["gap", None]]}),
        pa.table({"session": ["a"], "row": ["one"], "log_time_ns": [1], "flags": [["gap"]]}),
    ):
        pq.write_table(table, path)
        with pytest.raises(DatasetError, match=r"a\.parquet: damaged"):
            find_flagged_frames(tmp_path)
    path.write_bytes(b"PAR1 no more")
    with pytest.raises(DatasetError, match=r"a\.parquet: damaged"):
        find_flagged_frames(tmp_path)
    path.unlink()
    write_frames(tmp_path / "elsewhere", "a", [["gap"]])
    path.symlink_to(tmp_path / "elsewhere" / "frames" / "a.parquet")
    with pytest.raises(DatasetError, match=r"a\.parquet: damaged"):
        find_flagged_frames(tmp_path)


LONG_NAME = "a[b]" * 20


def test_the_report_has_a_line_a_stretch_and_the_sums_in_rows(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    print_quality_report([])
    assert capsys.readouterr().out == "no frame has a flag\n"
    print_quality_report(
        [
            FlaggedFrames(LONG_NAME, "gap", 7, 7, 0.1, 9.1, "2024-07-13T14:30:16.100+00:00", 3, 1),
            FlaggedFrames(LONG_NAME, "gap", 1200, 1300, 100, 110, "2024-07-13T14:32:16.100+00:00", 303, 101),
        ]
    )
    lines = capsys.readouterr().out.splitlines()
    assert [line.replace("│", " ").split() for line in lines if "2024" in line] == [
        [LONG_NAME, "gap", "7", "0.10", "to", "9.10", "2024-07-13", "14:30:16"],
        [LONG_NAME, "gap", "1200", "to", "1300", "100.00", "to", "110.00", "2024-07-13", "14:32:16"],
    ]
    assert lines[-1] == "102 rows gap"


def test_the_report_has_a_crash_with_its_surroundings_in_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")

    def rows(session: str, flag: str, first: int, last: int) -> FlaggedFrames:
        when = "2024-07-13T14:30:16.100+00:00"
        return FlaggedFrames(
            session, flag, first, last, first / 10, last / 10, when, last + 1 - first, last + 1 - first
        )

    crash = [("manoeuvring", 4, 9), ("crash", 10, 30), ("standing_still", 12, 14), ("backwards", 14, 20)]
    apart = [("manoeuvring", 31, 33), ("standing_still", 33, 50), ("frozen_picture", 12, 13), ("crash", 60, 61)]
    found = [rows("a", *each) for each in crash + apart] + [rows("b", "parked", 62, 99)]
    print_quality_report(sorted(found, key=lambda one: (one.session, one.first_row, one.flag)))
    lines = [line.split("  ") for line in capsys.readouterr().out.splitlines()]
    assert [[cell.strip() for cell in line if cell.strip()][:4] for line in lines[1:-1]] == [
        ["a", "manoeuvring, crash, backwards", "4 to 33", "0.40 to 3.30"],
        ["a", "frozen_picture", "12 to 13", "1.20 to 1.30"],
        ["a", "standing_still", "33 to 50", "3.30 to 5.00"],
        ["a", "crash", "60 to 61", "6.00 to 6.10"],
        ["b", "parked", "62 to 99", "6.20 to 9.90"],
    ]
    assert "7 rows backwards" in "".join(lines[-1])
