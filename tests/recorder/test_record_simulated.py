"""`bc-record` drives the built-in simulator: at several speeds into one session, and as people do (`--driver`)."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from dataset import IndexConfig, build_index
from recorder import Log
from recorder.cli import main as record_main
from recorder.log_cli import main as log_main
from recorder.sources.built_in_simulator import record_simulated
from recorder.sources.settings import SimulatedDrive
from simulator.roads.track import load_track
from tests.helpers.driving import one_line_in
from tests.helpers.udacity import call

LAPS = 0.012


def rows(path: Path) -> list[tuple[int, float, float]]:
    """Time in ns, steering and speed in mph of each row."""
    with Log(path) as log:
        return [(message.log_time_ns, state.steering, state.speed_mph) for message, state in log.vehicle_states()]


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("speeds")
    arguments = ("--laps", LAPS, "--seed", 5, "--rate", 5, "--speed", 10, 30, "--sessions", folder)
    assert call(record_main, "both", *arguments) == 0
    return folder / "both.mcap"


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("slow") / "slow.mcap"
    return record_simulated(SimulatedDrive(laps=LAPS, speed=(10.0,), seed=5, rate=5.0), path).path


def test_the_first_speed_is_driven_as_if_it_were_the_only_one(both: Path, slow: Path) -> None:
    alone = rows(slow)
    assert rows(both)[: len(alone)] == alone
    assert max(speed_mph for _, _, speed_mph in alone) < 10.5


def test_the_next_one_begins_at_rest_at_the_start_after_a_gap(both: Path, slow: Path) -> None:
    begin = len(rows(slow))
    times_ns, _, speeds_mph = zip(*rows(both), strict=True)
    assert all(before < after for before, after in pairwise(times_ns))
    assert times_ns[begin] - times_ns[begin - 1] >= 1_000_000_000  # as long as any other: nothing is learnt across
    assert speeds_mph[begin] == 0.0
    assert max(speeds_mph[begin:]) > 15.0
    line = load_track("lake").line
    with Log(both) as log:
        places = [pose.pose.position for _, pose in log.decoded("/pose")]
    arcs_m = [line.project(place.x, place.y)[0] for place in places]
    behind_start_m = line.length_m - 3.0  # the pose is that of the rear axle
    assert arcs_m[begin] > behind_start_m
    assert all(arc_m <= LAPS * line.length_m or arc_m > behind_start_m for arc_m in arcs_m)


def test_the_same_speed_again_is_another_drive(tmp_path: Path) -> None:
    drive = SimulatedDrive(laps=LAPS / 4, speed=(10.0, 10.0), seed=5, rate=5.0)
    driven = rows(record_simulated(drive, tmp_path / "twice.mcap").path)
    (begin,) = [row for row, (_, _, speed_mph) in enumerate(driven) if row and speed_mph == 0.0]
    first, second = ([steering for _, steering, _ in driven[part]] for part in (slice(begin), slice(begin, None)))
    assert first != second


def test_the_session_shows_its_speeds_and_where_each_begins(both: Path, slow: Path) -> None:
    begin = len(rows(slow))
    with Log(both) as log:
        assert log.metadata["drive.speed"] == "10 30"
        events = [
            (message.log_time_ns, event.message)
            for message, event in log.decoded("/events")
            if event.message.startswith("from")
        ]
    assert events == [
        (rows(both)[0][0], "from the start, at a set speed of 10 mph"),
        (rows(both)[begin][0], "from the start, at a set speed of 30 mph"),
    ]


def test_the_car_put_back_at_the_start_is_nothing_wrong(
    both: Path, slow: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nor is one pushed off its line: each gap has an event, and a check says so."""
    times_ns = [time_ns for time_ns, _, _ in rows(both)]
    far = [row for row, (before, after) in enumerate(pairwise(times_ns), start=1) if after - before > 1e9]
    assert len(rows(slow)) in far
    assert call(log_main, "check", both, "--json") == 0
    assert json.loads(capsys.readouterr().out)["meant_gaps"] == [f"before row {row}" for row in far]
    assert call(log_main, "check", both) == 0
    verdict, meant = capsys.readouterr().out.splitlines()
    assert verdict.endswith("nothing wrong")
    assert f"before row {far[0]}" in meant


def test_one_speed_is_recorded_as_ever(slow: Path) -> None:
    with Log(slow) as log:
        assert log.metadata["drive.speed"] == "10"
        assert log.counts.get("/events", 0) == 0


@pytest.mark.parametrize(
    ("speeds", "printed"), [((10, 0), "--speed 0"), (("nan",), "--speed nan"), ((), "--speed")]
)
def test_speeds_that_nobody_drives_are_refused(
    speeds: tuple[object, ...], printed: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(record_main, "x", "--sessions", tmp_path, "--speed", *speeds) == 2
    assert printed in one_line_in(capsys)
    assert list(tmp_path.iterdir()) == []


# Simulated people


def test_the_log_names_the_driver_and_is_indexed_whole(tmp_path: Path) -> None:
    arguments = ("--sessions", tmp_path, "--driver", "keyboard", "--laps", "0.008", "--recovery", "0")
    assert call(record_main, "mine", *arguments) == 0
    with Log(tmp_path / "mine.mcap") as log:
        assert (log.metadata["source"], log.metadata["driver"]) == ("simulator", "keyboard")
        steering = log.vehicle()["steering"].to_numpy()
    assert np.mean(steering == 0.0) > 0.3
    # takeovers are chosen by the commands of a drive: a session has none, and is taken whole
    index = build_index([tmp_path / "mine.mcap"], tmp_path / "index", IndexConfig(drives="takeovers"))
    assert index.frames.num_rows == 3 * len(steering)
    assert index.counts["mine"].not_taken_over == 0


@pytest.mark.parametrize(
    ("arguments", "printed"),
    [
        (("--from", "recording", "--driver", "keyboard"), "--driver: no such flag"),
        (("--listen", "--driver", "mouse"), "bc-record listen: --driver: no such flag"),
        (("--driver", "wheel"), "wheel"),
    ],
)
def test_a_driver_that_cannot_be_is_a_mistake_in_the_command(
    arguments: tuple[str, ...], printed: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(record_main, "x", "--sessions", tmp_path, *arguments) == 2
    assert printed in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
