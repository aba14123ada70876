"""A car driven backwards is found by its numbers, named at import, not learnt, and tagged by one command."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from common.errors import UsageError
from dataset import IndexConfig, build_index
from recorder import Log
from recorder.cli import main as record
from recorder.log.row_condition import rows_where
from recorder.log.row_quality import States, row_flags
from recorder.log.tags import read_tags
from recorder.log_cli import main as log_command
from simulator.driving.course import Course
from simulator.driving.expert import Expert
from simulator.roads.track import load_track
from udacity import call, make_recording, paths

STEPS_A_ROW = 5  # 10 rows a second


@dataclass
class Driven:
    """The numbers of a drive as Udacity's simulator writes them, whose speed has no sign, and the truth."""

    numbers: list[tuple[float, float, float, float]] = field(default_factory=list)
    speed_mph: list[float] = field(default_factory=list)

    def add(self, steering: float, throttle: float, speed_mph: float) -> None:
        self.numbers.append((steering, max(0.0, throttle), max(0.0, -throttle), abs(speed_mph)))
        self.speed_mph.append(speed_mph)

    @property
    def states(self) -> States:
        steering, throttle, brake, speed = np.array(self.numbers).T
        rows = np.arange(len(speed))
        return States(rows, rows * 100_000_000, steering, throttle, brake, speed)


def pedals(track: str, throttles: Iterable[tuple[float, float]], start: float = 0.0) -> Driven:
    """A drive by these throttles, each held for so many seconds."""
    course, driven = Course(load_track(track)), Driven()
    course.start(start * load_track(track).line.length_m)
    for throttle, seconds in throttles:
        for step in range(round(seconds * 50)):
            course.advance(0.0, throttle)
            if step % STEPS_A_ROW == 0:
                driven.add(0.0, throttle, course.vehicle.speed_mph)
    return driven


THERE_AND_BACK = [(1.0, 3.0), (-1.0, 8.0), (0.0, 1.0), (1.0, 4.0)]


def test_what_was_driven_backwards_is_found_without_a_sign_of_speed() -> None:
    driven = pedals("lake", THERE_AND_BACK)
    truth = np.array(driven.speed_mph) < -0.5
    found = row_flags(driven.states)["backwards"]
    assert truth.sum() > 30
    assert (found != truth).sum() <= 3  # where it stands


def test_a_speed_with_a_sign_says_it() -> None:
    driven = pedals("lake", THERE_AND_BACK)
    states = driven.states
    states.speed_mph[:] = driven.speed_mph
    assert (row_flags(states)["backwards"] == (states.speed_mph < -0.5)).all()


@pytest.mark.parametrize("track", ["lake", "mountain", "random:1"])
def test_a_fast_expert_never_drives_backwards(track: str) -> None:
    road = load_track(track)
    course, driven, expert = Course(road), Driven(), Expert(road.line, 30.0, 0.03, 0)
    course.start()
    for step in range(50 * 40):
        steering, throttle = expert.control(course)
        course.advance(steering, throttle)
        if step % STEPS_A_ROW == 0:
            driven.add(steering, throttle, course.vehicle.speed_mph)
    assert not row_flags(driven.states)["backwards"].any()


@pytest.mark.parametrize("start", [0.1, 0.3, 0.5, 0.7])
def test_braking_and_rolling_on_hills_is_not_driving_backwards(start: float) -> None:
    driven = pedals("mountain", [(1.0, 3.0), (0.0, 3.0), (1.0, 3.0), (-0.3, 1.0), (1.0, 2.0)], start)
    assert min(driven.speed_mph) >= -0.5
    assert not row_flags(driven.states)["backwards"].any()


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Driven:
    """A recording as Udacity's simulator writes it, imported as `mine`."""
    monkeypatch.chdir(tmp_path)
    driven = pedals("lake", [(1.0, 5.0), (-1.0, 10.0), *THERE_AND_BACK[2:]])
    rows = range(len(driven.numbers))
    csv = "".join(f"{paths(row)},{','.join(map(str, driven.numbers[row]))}\n" for row in rows)
    make_recording(Path("drive"), csv, rows)
    assert call(record, "mine", "--from", "drive") == 0
    return driven


def test_an_import_names_it_and_it_is_not_learnt(recording: Driven, capsys: pytest.CaptureFixture[str]) -> None:
    found = row_flags(recording.states)["backwards"]
    assert call(record, "mine", "--from", "drive", "--force") == 0
    message = capsys.readouterr().err
    assert f"odd: {found.sum()} rows driven backwards: rows {found.argmax()} to" in message
    assert "bc-log tag sessions/mine.mcap exclude --odd" in message
    counts = build_index([Path("sessions/mine.mcap")], Path("index")).counts["mine"]
    assert counts.crashed > 0
    as_recorded = IndexConfig(labels="as-recorded")
    assert build_index([Path("sessions/mine.mcap")], Path("other"), as_recorded).counts["mine"].crashed == 0


def test_one_command_excludes_it_and_one_takes_that_back(recording: Driven) -> None:
    log = Path("sessions/mine.mcap")
    assert call(log_command, "tag", log, "exclude", "--odd") == 0
    with Log(log) as opened:
        fingerprint = opened.fingerprint
    tagged = np.zeros(len(recording.numbers), np.bool_)
    for tag in read_tags(log, fingerprint):
        tagged[tag.first_row : tag.last_row + 1] = True
    assert (tagged == row_flags(recording.states)["backwards"]).all()
    assert call(log_command, "tag", log, "exclude", "--odd", "--remove") == 0
    assert not read_tags(log, fingerprint)


def test_rows_are_tagged_by_a_condition(recording: Driven) -> None:
    log = Path("sessions/mine.mcap")
    assert call(log_command, "tag", log, "slow", "--where", "speed_mph < 2 and throttle == 0") == 0
    with Log(log) as opened:
        tags = read_tags(log, opened.fingerprint)
    slow = {row for tag in tags for row in range(tag.first_row, tag.last_row + 1)}
    assert slow == {row for row, (_, pedal, _, mph) in enumerate(recording.numbers) if mph < 2 and pedal == 0}
    assert call(log_command, "tag", log, "slow", "--where", "row < 0") == 1


@pytest.mark.parametrize(
    "condition", ["", "speed < 2", "speed_mph", "speed_mph < x", "__import__('os')", "row < 1 or row > 2"]
)
def test_what_is_no_condition_is_refused(condition: str) -> None:
    with pytest.raises(UsageError, match="speed_mph < 2 and throttle == 0"):
        rows_where(pedals("lake", [(1.0, 0.5)]).states, condition)
