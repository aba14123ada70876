"""The flags of frames, and which of them cannot be used."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import numpy as np
import pyarrow as pa
from hypothesis import given
from hypothesis import strategies as st

from common.car import CAMERAS, Camera
from dataset.frames.frame_flags import ImageFindings, Paired, frame_flags, is_unusable
from recorder.rows.causes import PICTURE_FLAGS, ROW_FLAGS
from recorder.rows.row_quality import States

STEP_NS = 100_000_000
START_NS = int(datetime(2024, 7, 13, 14, 30, 16, tzinfo=UTC).timestamp()) * 10**9
NOTHING_FOUND = ImageFindings(0, {}, {})


def states(rows: int, **columns: Any) -> States:
    """A drive without anything odd, but for the columns given."""
    reported = {
        "row": np.arange(rows),
        "time_ns": START_NS + np.arange(rows) * STEP_NS,
        "steering": np.arange(rows) / rows,
        "throttle": np.full(rows, 0.5),
        "brake": np.zeros(rows),
        "speed_mph": np.full(rows, 9.0),
        **{name: np.asarray(column) for name, column in columns.items()},
    }
    return States(**reported)


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
    reported = states(rows, speed_mph=np.where(standing, 0.0, 5.0), throttle=np.where(wrong, 7.0, 0.5))
    looked = ImageFindings(rows, {"center": tuple((int(at), int(at)) for at in np.flatnonzero(broken))}, {})
    in_order: list[str] = [*ROW_FLAGS, *PICTURE_FLAGS]
    names = ("standing_still", "out_of_range", "broken_picture")
    assert frame_flags(reported, {"center": every(rows)}, looked).to_pylist() == [
        sorted((name for name, holds in zip(names, row, strict=True) if holds), key=in_order.index) for row in odd
    ]


def test_only_steering_out_of_range_and_broken_pictures_cannot_be_used() -> None:
    reported = ["gap", "frozen_picture", "missing_picture", "stuck_steering", "standing_still"]
    flags = [["out_of_range"], ["out_of_range"], ["broken_picture"], reported, []]
    table = pa.table({"bin": [-1, 12, 3, 4, 5], "flags": pa.array(flags, pa.list_(pa.string()))})
    assert is_unusable(table).tolist() == [True, False, True, False, False]  # the second one's pedals are
    twice = pa.concat_tables([table, table])
    assert is_unusable(twice).tolist() == is_unusable(table).tolist() * 2
