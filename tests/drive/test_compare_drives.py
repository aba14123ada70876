"""`bc-eval compare A B --tracks`: both drive the same roads, and are compared stretch by stretch."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drive.config import DriveConfig
from drive.evaluation.closed_loop import BuiltInSimulator, DriveResult
from drive.evaluation.drive_comparison import DriveComparison
from drive.evaluation.eval_cli import main
from recorder import LogWriter
from recorder.log.writer import pose_message
from simulator.driving.vehicle import AXLE_TO_CENTRE_M
from simulator.pose import Pose
from simulator.roads.track import load_track
from tests.helpers.driving import untrained_run
from tests.helpers.udacity import call

LAKE = load_track("lake")
STEP_NS = 200_000_000
PUT_BACK = "off the road, or stuck: the simulator put the car back"


def drive(
    path: Path,
    offset: Callable[[float], float],
    put_back_m: tuple[float, ...] = (),
    gave_up: bool = False,
    length_m: float = LAKE.line.length_m,
) -> DriveResult:
    """The log of a lap of the lake at 5 m/s, so far to the left of the centre line (a share of the half width, at
    an arc length in m), and put back at these. Its first two messages are of one moment, a hair before the line,
    as those of the simulator."""
    moving = [(row * STEP_NS, float(row)) for row in range(1, int(length_m))]
    waiting = sorted(put_back_m)
    with LogWriter(path, {"source": "test"}) as writer:
        for row, (time_ns, arc_m) in enumerate([(0, -1e-6), (1, -1e-6), *moving]):
            place = LAKE.line.at(arc_m)
            at = round(arc_m / LAKE.line.step_m) % len(LAKE.half_width_m)
            off_m = offset(arc_m) * float(LAKE.half_width_m[at])
            x_m = place.x_m - off_m * math.sin(place.heading_rad) - AXLE_TO_CENTRE_M * math.cos(place.heading_rad)
            y_m = place.y_m + off_m * math.cos(place.heading_rad) - AXLE_TO_CENTRE_M * math.sin(place.heading_rad)
            pose = Pose(x_m, y_m, place.z_m, place.heading_rad, 0.05, -0.1)
            writer.pose(time_ns, row, pose_message(pose, time_ns))
            while waiting and waiting[0] <= arc_m:
                waiting.pop(0)
                writer.event(time_ns, PUT_BACK, "INFO", "drive")
    return DriveResult(BuiltInSimulator("lake"), DriveConfig(), path, {"gave_up": gave_up, "track": "lake"})


def compared(a: DriveResult, b: DriveResult) -> tuple[str, dict[str, Any]]:
    comparison = DriveComparison("a", "b", [a], [b]).as_dict()
    return comparison["verdict"], comparison["measures"]


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> DriveResult:
    return drive(tmp_path_factory.mktemp("good") / "good.mcap", lambda arc_m: 0.1)


def test_a_drive_that_goes_farther_from_the_line_everywhere_is_worse(good: DriveResult, tmp_path: Path) -> None:
    wide = drive(tmp_path / "wide.mcap", lambda arc_m: 0.2 + 0.1 * math.sin(arc_m))
    verdict, measures = compared(good, wide)
    assert (verdict, measures["mean_offset"]["verdict"]) == ("worse", "worse")
    assert measures["mean_offset"]["a"] == pytest.approx(0.1, abs=0.005)
    assert measures["mean_offset"]["b"] == pytest.approx(0.2, abs=0.01)
    assert compared(wide, good)[0] == "better"
    assert compared(good, good)[0] == "not told apart"


def test_a_second_speed_is_no_other_road(good: DriveResult, tmp_path: Path) -> None:
    """The same drives twice say as much as once."""
    wide = drive(tmp_path / "wide.mcap", lambda arc_m: 0.1 + 0.1 * math.sin(arc_m / 20))
    once, twice = (DriveComparison("a", "b", [good] * speeds, [wide] * speeds) for speeds in (1, 2))
    assert once.stretches == twice.stretches
    assert once.as_dict()["measures"]["mean_offset"] == twice.as_dict()["measures"]["mean_offset"]


def test_only_stretches_of_the_driven_road_count(tmp_path: Path) -> None:
    """195 m are four stretches of some 50 m. The moment before the line is none."""
    short = drive(tmp_path / "short.mcap", lambda arc_m: 0.1, length_m=195.0)
    assert DriveComparison("a", "b", [short], [short]).stretches == 4


def test_one_intervention_may_be_chance_and_ten_elsewhere_are_not(good: DriveResult, tmp_path: Path) -> None:
    once = drive(tmp_path / "once.mcap", lambda arc_m: 0.1, (200.0,))
    verdict, measures = compared(good, once)
    assert (verdict, measures["interventions"]["b"]) == ("not told apart", 1)
    often = drive(tmp_path / "often.mcap", lambda arc_m: 0.1, tuple(90.0 * n + 5 for n in range(10)))
    verdict, measures = compared(good, often)
    assert (verdict, measures["interventions"]["verdict"], measures["autonomy_percent"]["verdict"]) == (
        *("worse", "worse"),
        "worse",
    )
    assert measures["interventions"]["b"] == 10
    seconds = (int(LAKE.line.length_m) - 1) * STEP_NS / 1e9
    assert measures["autonomy_percent"]["b"] == pytest.approx(100 * (1 - 6 * 10 / seconds))


def test_a_drive_that_was_given_up_is_worse_whatever_the_rest_reports(good: DriveResult, tmp_path: Path) -> None:
    stuck = drive(tmp_path / "stuck.mcap", lambda arc_m: 0.1, gave_up=True)
    assert compared(good, stuck)[0] == "worse"
    assert compared(stuck, stuck)[0] == "not told apart"


def test_a_run_drives_no_worse_than_itself_and_as_its_own_report_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    untrained_run(tmp_path / "runs" / "untrained", seed=1)
    flags = ("--tracks", "lake", "--laps", 0.002)
    assert call(main, "compare", "untrained", "untrained", *flags, "--json") == 0
    comparison = json.loads(capsys.readouterr().out)
    assert comparison["verdict"] == "not told apart"
    (pair,) = comparison["drives"]
    assert pair["a"]["trajectory_sha256"] == pair["b"]["trajectory_sha256"]
    assert [pair[side]["log"] for side in "ab"] == [f"drives/{side}/untrained-lake-10mph.mcap" for side in "ab"]
    for name, measure in comparison["measures"].items():
        assert measure["a"] == pytest.approx(pair["a"][name], rel=0.05, abs=0.02), name
    assert call(main, "compare", "untrained", "untrained", *flags) == 1  # the logs are there already
    assert "exists already: give --drives FOLDER for another place, or give --force" in capsys.readouterr().err
    assert call(main, "compare", "untrained", "untrained", *flags, "--force") == 0
    logs = "drives/a/untrained-lake-10mph.mcap drives/b/untrained-lake-10mph.mcap"
    assert f"bc-play {logs} --by place`" in capsys.readouterr().err.splitlines()[-1]
