"""What is odd in a recording: each kind on a drive that has it, and none on drives that do not."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log.findings import Findings
from recorder.rows.odd_stretches import OddStretch, odd_advice, odd_lines, odd_stretches
from recorder.rows.row_quality import States
from recorder.sources.udacity_recording import read_udacity
from recorder.upkeep.log_info import describe

RATE_HZ = 10
Part = tuple[float, float, float, float, float]
"""Seconds, steering, pedal (the brake below 0), and the speed at their begin and end."""

CRUISE: Part = (15.0, 0.0, 0.5, 20.0, 20.0)
STOP: Part = (1.0, 0.0, -1.0, 20.0, 0.0)
START: Part = (2.0, 0.0, 1.0, 0.0, 20.0)
LEFT: Part = (1.0, -0.98, 0.5, 20.0, 20.0)
RIGHT: Part = (1.0, 0.98, 0.5, 20.0, 20.0)


def driven(*parts: Part) -> States:
    rows: list[tuple[float, float, float, float]] = []
    for seconds, steering, pedal, begin_mph, end_mph in parts:
        for speed_mph in np.linspace(begin_mph, end_mph, round(seconds * RATE_HZ), endpoint=False):
            rows.append((steering + 0.01 * math.sin(len(rows)), max(0.0, pedal), max(0.0, -pedal), speed_mph))
    number = np.arange(len(rows))
    return States(100 + number, number * 10**9 // RATE_HZ, *np.array(rows).T.copy())


def found_in(*parts: Part) -> list[tuple[str, float, float, bool]]:
    return [
        (stretch.kind, stretch.begin_s, stretch.end_s, stretch.is_sure)
        for stretch in odd_stretches(driven(*parts))
    ]


def test_reversing_is_driving_backwards_until_the_car_stands_again() -> None:
    back = [STOP, (3.0, 0.1, -1.0, 0.0, 12.0), (1.0, 0.1, 0.5, 12.0, 0.0)]
    ((kind, begin_s, end_s, is_sure),) = found_in(CRUISE, *back, START, CRUISE)
    assert (kind, is_sure) == ("backwards", True)
    assert begin_s == pytest.approx(16.0, abs=0.2)
    assert 20.0 <= end_s < 21.5  # and until it drives again


def test_a_speed_below_zero_needs_no_pedals() -> None:
    ((kind, begin_s, _, is_sure),) = found_in(CRUISE, STOP, (3.0, 0.1, 0.0, -0.6, -4.0), START, CRUISE)
    assert (kind, begin_s, is_sure) == ("backwards", 16.0, True)
    assert found_in(CRUISE, STOP, (1.5, 0.0, 0.0, -0.6, -0.6), START, CRUISE) == []  # noise of a car that stands


def test_without_a_brake_it_may_roll_downhill_and_is_not_sure() -> None:
    ((kind, _, _, is_sure),) = found_in(CRUISE, STOP, (4.0, 0.1, 0.0, 0.0, 9.0), (5.0, 0.1, 0.0, 9.0, 9.0))
    assert (kind, is_sure) == ("backwards", False)


def test_the_approach_the_reversing_and_the_way_out_belong_to_the_crash() -> None:
    wall = [(1.0, 0.0, 1.0, 0.1, 0.1), (3.0, 1.0, -1.0, 0.0, 6.0), (1.0, 0.0, 1.0, 6.0, 0.0), START]
    (crash,) = odd_stretches(driven(CRUISE, *wall, CRUISE))
    assert (crash.kind, crash.is_sure, crash.is_learnt) == ("crash", True, False)
    assert crash.begin_s == pytest.approx(14.0, abs=0.1)
    assert 20.5 <= crash.end_s <= 21.5
    assert "hits something at row 250" in crash.cause
    assert "backwards" in crash.cause
    assert crash.command(Path("my logs/a.mcap")) == (
        f"bc-log tag 'my logs/a.mcap' exclude --rows {crash.first_row} {crash.last_row}"
    )


def test_bends_in_degrees_are_another_scale_and_not_to_be_excluded() -> None:
    (scale,) = odd_stretches(driven(CRUISE, (4.0, 12.0, 0.5, 20.0, 20.0), CRUISE))
    assert (scale.kind, scale.first_row, scale.rows, scale.is_sure) == ("out_of_range", 100, 340, False)
    assert "beyond -1..1 in 12% of the rows: another scale, such as degrees?" in scale.cause
    assert odd_advice([scale], Path("a.mcap")) == []
    ((_, begin_s, _, is_sure),) = found_in(CRUISE, (1.0, 12.0, 0.5, 20.0, 20.0), CRUISE)
    assert (begin_s, is_sure) == (15.0, True)


def test_a_parked_car_stands_for_long_and_an_ordinary_start_does_not() -> None:
    ((kind, begin_s, end_s, is_sure),) = found_in(CRUISE, STOP, (8.0, 0.0, 0.0, 0.0, 0.0), START, CRUISE)
    assert (kind, is_sure) == ("parked", True)
    assert [begin_s, end_s] == pytest.approx([16.0, 24.0], abs=0.1)
    assert found_in((3.5, 0.0, 0.0, 0.0, 0.0), START, CRUISE) == []
    assert found_in((60.0, 0.0, 0.0, 0.0, 0.0)) == []  # nobody measures a speed


def test_creeping_and_coasting_to_a_halt_are_reported_but_not_sure() -> None:
    creep = [STOP, (4.0, 0.0, 0.1, 0.6, 2.0), START]
    assert [stretch[0::3] for stretch in found_in(CRUISE, *creep, CRUISE)] == [("creeping", False)]
    coast = [(6.0, 0.0, 0.0, 20.0, 0.0), (1.0, 0.0, 0.0, 0.0, 0.0), START]
    assert [stretch[0::3] for stretch in found_in(CRUISE, *coast, CRUISE)] == [("coasting", False)]


def test_full_lock_to_and_fro_is_weaving_as_long_as_it_lasts() -> None:
    # from the end of the first full lock to the begin of the last one; without poses, it is not sure
    assert found_in(CRUISE, *[LEFT, RIGHT] * 3, CRUISE) == [("weaving", 15.9, 20.0, False)]


@pytest.mark.parametrize(
    "parts",
    [
        pytest.param([START, CRUISE, STOP, (2.0, 0.0, -1.0, 0.0, 0.0), START, CRUISE], id="a stop"),
        pytest.param([CRUISE, (4.0, 0.0, -0.2, 10.0, 14.0), CRUISE], id="downhill with a light brake"),
        pytest.param([CRUISE, (4.0, 0.0, 0.0, 10.0, 20.0), CRUISE], id="downhill without a pedal"),
        pytest.param([(9.0, 0.0, 0.0, 0.0, 20.0), (9.0, 0.0, 0.0, 20.0, 20.0)], id="no pedals were recorded"),
        pytest.param([START, CRUISE, (3.0, 0.6, 0.2, 7.0, 7.0), CRUISE], id="a hairpin"),
        pytest.param([START, (5.0, 0.0, 1.0, math.nan, math.nan), CRUISE], id="an unknown speed"),
        pytest.param([START, LEFT, RIGHT, CRUISE, RIGHT, LEFT, RIGHT, CRUISE], id="bends at full lock"),
    ],
)
def test_what_is_ordinary_is_not_odd(parts: list[Part]) -> None:
    assert found_in(*parts) == []


def test_a_log_keeps_what_is_odd_and_an_earlier_one_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    states = driven(CRUISE, STOP, (3.0, 0.1, -1.0, 0.0, 12.0), (1.0, 0.1, 0.5, 12.0, 0.0), START, CRUISE)

    def written(name: str) -> list[OddStretch] | None:
        with LogWriter(tmp_path / name, {"source": "test"}) as writer:
            for at, row in enumerate(states.row.tolist()):
                state = VehicleState(
                    steering=states.steering[at],
                    throttle=states.throttle[at],
                    brake=states.brake[at],
                    speed_mph=states.speed_mph[at],
                )
                writer.vehicle(int(states.time_ns[at]), row, state)
        return describe(tmp_path / name).odd

    expected = odd_stretches(states)
    assert [stretch.kind for stretch in expected] == ["backwards"]
    assert written("a.mcap") == expected
    as_metadata = Findings.as_metadata
    for name, other in (("earlier", {"odd": ""}), ("foreign", {"odd": "[{}]"})):
        monkeypatch.setattr(Findings, "as_metadata", lambda self, other=other: as_metadata(self) | other)
        assert written(f"{name}.mcap") == expected


def test_what_is_odd_ends_with_the_command_that_excludes_it() -> None:
    sure = OddStretch("crash", 3, 9, 0.3, 0.9, "x", is_sure=True)
    unsure = OddStretch("creeping", 20, 29, 2.0, 2.9, "\x1b[1m", is_sure=False)
    lines, log = odd_lines([sure] * 8 + [unsure]), Path("sessions/a b.mcap")
    assert lines[0] == "crash: rows 3 to 9, 0.3 to 0.9 s (x)"
    assert lines[6] == "and 3 more stretches"
    *_, exclude, look = odd_advice([sure] * 8 + [unsure], log)
    assert "`bc-log tag 'sessions/a b.mcap' exclude --odd`" in exclude
    assert "`bc-log check 'sessions/a b.mcap'`" in look
    assert "`bc-log tag 'sessions/a b.mcap' exclude --rows 20 29`" in look
    *_, looked = odd_advice([unsure], log, is_looked=True)
    assert "bc-log check" not in looked
    assert "\x1b" not in str(unsure)
    assert odd_lines([]) == odd_advice([], log) == []


def test_on_real_recordings_the_crashes_are_found_and_nothing_else(recordings: Path) -> None:
    """Film strips of all of them were looked at: four walls of the old mountain, two of them one after the other,
    and the tree at which the jungle ends."""
    by_name = {}
    for name in ("lake_windows", "lake_14hz", "jungle_linux", "mountain_linux"):
        rows = [row for row in read_udacity(recordings / name).rows if not row.problem]
        values = [(row.steering, row.throttle, row.brake, row.speed) for row in rows]
        time_ns = np.array([row.time for row in rows])
        odd = odd_stretches(States(np.arange(len(rows)), time_ns, *np.array(values).T.copy()))
        by_name[name] = [(stretch.kind, stretch.first_row, stretch.last_row) for stretch in odd]
    assert by_name == {
        "lake_windows": [],
        "lake_14hz": [],
        "jungle_linux": [("crash", 1143, 1166)],
        "mountain_linux": [("crash", 350, 446), ("crash", 1063, 1116), ("crash", 1161, 1211)],
    }
