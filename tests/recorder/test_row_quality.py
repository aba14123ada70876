"""What is odd about the rows of a log: each flag on rows made for it, and what a written log says of its own."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder import Log, LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.rows.causes import ROW_FLAGS
from recorder.rows.row_quality import States, drive_numbers
from tests.helpers.logs import START_NS
from tests.helpers.plain_mcap import contents

SECOND_NS = 1_000_000_000


def states(
    time_s: list[float],
    *,
    steering: list[float] | float = 0.0,
    throttle: float = 0.5,
    brake: float = 0.0,
    speed_mph: list[float] | float = 9.0,
) -> States:
    """Rows at these seconds; their numbers do not begin at 0."""

    def column(value: list[float] | float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        return np.array(np.broadcast_to(np.array(value, np.float64), len(time_s)))

    return States(
        row=np.arange(100, 100 + len(time_s)),
        time_ns=START_NS + np.array([round(second * 1e9) for second in time_s], np.int64),
        steering=column(steering),
        throttle=column(throttle),
        brake=column(brake),
        speed_mph=column(speed_mph),
    )


def flagged(rows: States, flag: str) -> list[int]:
    """The positions of the rows that a flag holds for."""
    positions: list[int] = np.flatnonzero(rows.flags[flag]).tolist()
    return positions


def every_tenth(count: int) -> list[float]:
    return [i / 10 for i in range(count)]


def test_a_gap_is_more_than_a_second_or_time_that_goes_back() -> None:
    rows = states([0.0, 0.1, 1.1, 2.2, 2.3, 1.0, 1.0, 1.1])
    assert flagged(rows, "gap") == [3, 5]
    assert drive_numbers(rows.time_ns).tolist() == [0, 0, 0, 1, 1, 2, 2, 2]


@pytest.mark.parametrize(
    ("values", "is_out"),
    [
        ({"steering": -1.0}, False),
        ({"steering": 1.0001}, True),
        ({"steering": math.nan}, True),
        ({"throttle": 1.0}, False),
        ({"throttle": -0.1}, True),
        ({"brake": 1.1}, True),
        ({"speed_mph": math.nan}, False),
        ({"speed_mph": -30.0}, False),
        ({"speed_mph": -40.0}, True),
        ({"speed_mph": 300.0}, False),
        ({"speed_mph": 99999.0}, True),
        ({"speed_mph": math.inf}, True),
    ],
)
def test_values_out_of_range(values: dict[str, float], is_out: bool) -> None:
    """A speed that is not known is no fault."""
    assert flagged(states([0.0, 0.1], **values), "out_of_range") == ([0, 1] if is_out else [])


def test_standing_still_is_below_half_a_mile_an_hour_and_known() -> None:
    rows = states(every_tenth(7), speed_mph=[0.0, 0.49, 0.5, 9.0, math.nan, -3.0, -0.4])
    assert flagged(rows, "standing_still") == [0, 1, 6]


def test_steering_is_stuck_after_three_seconds_and_straight_after_thirty() -> None:
    assert flagged(states(every_tenth(30), steering=0.25), "stuck_steering") == []
    assert flagged(states(every_tenth(31), steering=0.25), "stuck_steering") == list(range(31))
    assert flagged(states(every_tenth(300), steering=0.0), "stuck_steering") == []
    assert flagged(states(every_tenth(301), steering=0.0), "stuck_steering") == list(range(301))


def test_only_the_stuck_stretch_is_flagged() -> None:
    steering = [0.1, 0.2, *[0.25] * 31, 0.3, *[0.25] * 30]
    assert flagged(states(every_tenth(len(steering)), steering=steering), "stuck_steering") == list(range(2, 33))


def test_who_stands_still_may_hold_the_wheel() -> None:
    assert flagged(states(every_tenth(50), steering=0.25, speed_mph=0.0), "stuck_steering") == []
    moving_s = [0.0] * 25 + [9.0] * 25
    assert flagged(states(every_tenth(50), steering=0.25, speed_mph=moving_s), "stuck_steering") == []


def test_a_new_drive_begins_anew() -> None:
    times = [*every_tenth(20), *[10 + second for second in every_tenth(20)]]
    assert flagged(states(times, steering=0.25), "stuck_steering") == []


def driven(*parts: tuple[float, float, float]) -> States:
    """Rows every tenth of a second: so many seconds at this speed with this steering, one part after the other."""
    rows = [(speed, steering) for seconds, speed, steering in parts for _ in range(round(seconds * 10))]
    speeds, steerings = zip(*rows, strict=True)
    return states(every_tenth(len(rows)), speed_mph=list(speeds), steering=list(steerings))


CRUISE = (20.0, 24.0, 0.0)


def test_a_hit_and_the_manoeuvring_after_it_are_one_crash() -> None:
    at_the_wall = [(1.0, 0.2, 0.0), (2.0, 3.0, 1.0), (1.0, 6.0, -0.4)]
    rows = driven(CRUISE, *at_the_wall, (1.0, 12.0, -1.0), CRUISE)
    assert flagged(rows, "crash") == list(range(200, 240))


@pytest.mark.parametrize(
    "parts",
    [
        pytest.param([CRUISE, (2.0, 0.0, 0.0)], id="an impact, at whose wall the recording ends"),
        pytest.param([CRUISE, *[(0.2, 24 - 2 * i, 0.0) for i in range(12)], (2.0, 0.1, 0.9)], id="full lock"),
    ],
)
def test_a_crash_is_reported_by_its_impact_or_by_the_wheel(parts: list[tuple[float, float, float]]) -> None:
    assert len(flagged(driven(*parts, CRUISE), "crash")) >= 20


BRAKED = [(0.2, 24.0 - 2 * i, 0.0) for i in range(12)]


@pytest.mark.parametrize(
    "parts",
    [
        pytest.param([(3.0, 0.0, 1.0), (2.0, 5.0, 1.0), CRUISE], id="a start, whatever the wheel does"),
        pytest.param([CRUISE, *BRAKED, (5.0, 0.0, 0.0), (1.0, 5.0, 0.2), CRUISE], id="a stop"),
        pytest.param([CRUISE, *BRAKED[:10], (6.0, 4.0, 1.0), CRUISE], id="a hairpin"),
        pytest.param([(60.0, 3.0, 0.3), (5.0, 10.0, -1.0), (3.0, 1.5, 1.0), (9.0, 5.0, 0.9)], id="slow always"),
        pytest.param([CRUISE, (0.2, 0.0, 0.0), CRUISE], id="two rows without a speed"),
        pytest.param([CRUISE, (5.0, math.nan, 1.0), CRUISE], id="an unknown speed"),
        pytest.param([(30.0, 0.0, 1.0)], id="a car that never moves"),
    ],
)
def test_what_is_no_crash(parts: list[tuple[float, float, float]]) -> None:
    assert flagged(driven(*parts), "crash") == []


@pytest.mark.parametrize("rate_hz", [2, 60])
def test_a_crash_is_reported_at_any_rate(rate_hz: int) -> None:
    time_s = [i / rate_hz for i in range(30 * rate_hz)]
    speed_mph = [24.0 if second < 20 or second >= 24 else 0.1 for second in time_s]
    crash = flagged(states(time_s, speed_mph=speed_mph), "crash")
    assert [time_s[crash[0]], time_s[crash[-1]]] == [20.0, 24 - 1 / rate_hz]


numbers = st.floats(width=32) | st.sampled_from([0.0, -0.0, 1.0, math.inf, math.nan])


@given(st.lists(st.tuples(st.integers(0, 2**63 - 1), numbers, numbers, numbers, numbers), max_size=12))
def test_whatever_a_log_holds_its_rows_are_judged(rows: list[tuple[int, float, float, float, float]]) -> None:
    """Warnings are errors here, NumPy's of infinite values too."""
    columns = list(zip(*rows, strict=True)) or [()] * 5
    states = States(
        np.arange(len(rows)),
        np.array(columns[0], np.int64),
        *(np.array(column, np.float64) for column in columns[1:]),
    )
    flags = states.flags
    assert tuple(flags) == ROW_FLAGS
    assert {len(mask) for mask in flags.values()} == {len(rows)}


# In a log


def write(path: Path) -> Path:
    """Five seconds with a stuck wheel, a gap, and a row out of range."""
    with LogWriter(path, {"source": "test"}) as writer:
        for row in range(50):
            writer.vehicle(START_NS + row * SECOND_NS // 10, row, VehicleState(steering=0.25, speed_mph=9.0))
        writer.vehicle(START_NS + 10 * SECOND_NS, 50, VehicleState(steering=-25.0, speed_mph=0.0))
    return path


def test_a_written_log_reports_what_is_odd_about_its_rows(tmp_path: Path) -> None:
    reported = dict(contents(write(tmp_path / "a.mcap")).metadata)["bc.quality"]
    counts = {"gap": "1", "out_of_range": "1", "standing_still": "1", "stuck_steering": "50"}
    assert reported.items() >= ({"rows": "51", "drives": "2"} | counts).items()
    assert json.loads(reported["stretches"]) == [
        ["stuck_steering", 0, 49, 0.0, 4.9],
        ["gap", 50, 50, 4.9, 10.0],
        ["out_of_range", 50, 50, 10.0, 10.0],
        ["standing_still", 50, 50, 10.0, 10.0],
    ]
    with Log(tmp_path / "a.mcap") as log:
        assert log.read_metadata("bc.quality") == reported


def test_a_log_without_vehicle_states_reports_nothing(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.mcap", {}) as writer:
        writer.event(START_NS, "connected")
    assert "bc.quality" not in dict(contents(tmp_path / "a.mcap").metadata)


def test_at_most_a_hundred_stretches_are_listed_but_all_are_counted(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.mcap", {}) as writer:
        for row in range(400):
            state = VehicleState(steering=2.0 if row % 2 else row / 1000, speed_mph=9.0)
            writer.vehicle(START_NS + row * SECOND_NS // 10, row, state)
    reported = dict(contents(tmp_path / "a.mcap").metadata)["bc.quality"]
    assert (reported["out_of_range"], len(json.loads(reported["stretches"]))) == ("200", 100)
