"""`bc-play LOG LOG`: drives beside each other, by time and by place, as Rerun's own reader sees what is shown."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recorder import LogWriter
from recorder.bc_pb2 import PilotCommand, Prediction, VehicleState
from recorder.log.writer import pose_message
from simulator.pose import Pose
from tests.helpers.driving import road_jpeg
from tests.helpers.logs import START_NS
from tests.helpers.rrd import contents, view_names
from tests.helpers.udacity import call
from viz.cli import main
from viz.playback.comparison import distances_along, names_of

ROWS = 30
STEP_NS = 100_000_000
RADIUS_M = 50.0


def write_drive(
    path: Path, rows: int = ROWS, *, start_s: float = 0.0, speed_m_s: float = 10.0, poses: bool = True
) -> Path:
    """Along a circle, from its southernmost point, at a constant speed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with LogWriter(path, {"source": "test"}) as log:
        for row in range(rows):
            time_ns = START_NS + round(start_s * 1e9) + row * STEP_NS
            log.picture("center", time_ns, row, road_jpeg(row))
            log.vehicle(time_ns, row, VehicleState(steering=row / 100, speed_mph=speed_m_s))
            log.command(time_ns, row, PilotCommand(steering=-row / 100, driver=PilotCommand.PILOT))
            if poses:
                angle = speed_m_s * row * 0.1 / RADIUS_M
                x_m, y_m = RADIUS_M * math.sin(angle), -RADIUS_M * math.cos(angle)
                log.pose(time_ns, row, pose_message(Pose(x_m, y_m, 0.0, angle, 0.0, 0.0), time_ns))
        log.event(START_NS + round(start_s * 1e9), f"begins at {start_s:g} s")
    return path


def shown(rrd: Path, *words: object) -> dict[str, dict[str, list[Any]]]:
    assert call(main, *words, "--save", rrd) == 0
    return contents(rrd)


def values(shown: dict[str, dict[str, list[Any]]], entity: str, component: str = "Scalars:scalars") -> list[Any]:
    return [value[0] for value in shown[entity][component] if value]


def test_logs_of_different_days_stand_beside_each_other_from_their_starts(tmp_path: Path) -> None:
    logs = write_drive(tmp_path / "a.mcap"), write_drive(tmp_path / "b.mcap", start_s=86_400, speed_m_s=20)
    entities = shown(tmp_path / "x.rrd", *logs)
    since_start = [row * STEP_NS for row in range(ROWS)]
    for name, speed in (("a", 10.0), ("b", 20.0)):
        times = entities[f"/{name}/steering/recorded"]["since start"]
        assert [round(time.total_seconds() * 1e9) for time in times] == since_start
        assert values(entities, f"/{name}/steering/recorded") == pytest.approx([row / 100 for row in range(ROWS)])
        assert values(entities, f"/{name}/steering/sent") == pytest.approx([-row / 100 for row in range(ROWS)])
        assert values(entities, f"/{name}/speed_mph/driven") == [speed] * ROWS
        blobs = values(entities, f"/{name}/camera/center", "EncodedImage:blob")
        assert [bytes(blob) for blob in blobs] == [road_jpeg(row) for row in range(ROWS)]
        assert len(values(entities, f"/{name}/path/car", "Arrows2D:origins")) == ROWS
        assert values(entities, f"/{name}/driver", "StateChange:state") == ["pilot"]
    assert values(entities, "/b/events", "TextLog:text") == ["begins at 86400 s"]
    assert not {entity for entity in entities if not entity.startswith(("/a/", "/b/", "/__"))}


def test_by_place_the_same_place_has_the_same_number(tmp_path: Path) -> None:
    """The second drive is twice as fast: after half the time it is at the same place."""
    logs = write_drive(tmp_path / "a.mcap"), write_drive(tmp_path / "b.mcap", start_s=50, speed_m_s=20)
    entities = shown(tmp_path / "x.rrd", *logs, "--by", "place")
    driven_cm = {name: [speed * row * 10 for row in range(ROWS)] for name, speed in (("a", 10), ("b", 20))}
    assert entities["/a/steering/recorded"]["place_cm"] == pytest.approx(driven_cm["a"], abs=2)
    assert entities["/a/camera/center"]["place_cm"] == entities["/a/steering/recorded"]["place_cm"]
    together = [at for at in driven_cm["b"] if at <= driven_cm["a"][-1]]
    assert entities["/b/steering/recorded"]["place_cm"][: len(together)] == pytest.approx(together, abs=2)
    beyond = driven_cm["b"][len(together) :]  # where the first has not been
    assert entities["/b/camera/center"]["place_cm"][len(together) :] == pytest.approx(beyond, abs=100)


def test_the_layout_has_every_view_of_each_log_and_what_they_share(tmp_path: Path) -> None:
    logs = write_drive(tmp_path / "a.mcap"), write_drive(tmp_path / "b.mcap", poses=False)
    shown(tmp_path / "x.rrd", *logs)
    views = ("centre camera", "who drives", "steering, -1 left .. 1 right", "events")
    both = {f"{name}: {view}" for name in ("a", "b") for view in views}
    assert view_names(tmp_path / "x.rrd") == both | {"speed, mph", "paths from above, m"}


def test_a_log_without_a_sound_end_is_compared_and_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, part = write_drive(tmp_path / "a.mcap"), tmp_path / "killed.mcap"
    data = write_drive(tmp_path / "b.mcap", 4 * ROWS).read_bytes()  # more than a chunk
    part.write_bytes(data[: len(data) * 7 // 10])
    assert call(main, whole, part, "--save", tmp_path / "x.rrd") == 3
    assert f"{part}: unfinished" in capsys.readouterr().err
    entities = contents(tmp_path / "x.rrd")
    assert 0 < len(values(entities, "/killed/camera/center", "EncodedImage:blob")) < 4 * ROWS
    assert len(values(entities, "/a/camera/center", "EncodedImage:blob")) == ROWS


def test_what_networks_said_stands_beside_what_was_driven(tmp_path: Path) -> None:
    drive, other = write_drive(tmp_path / "a.mcap"), tmp_path / "said.mcap"
    with LogWriter(other, {"source": "prediction"}) as log:
        for row in range(ROWS):
            steering = Prediction(steering=-row / 100, recorded_steering=row / 100)
            log.prediction("first", START_NS + row * STEP_NS, row, steering)
    entities = shown(tmp_path / "x.rrd", drive, other)
    predicted = values(entities, "/said/steering/predicted_by/first")
    assert predicted == pytest.approx([-row / 100 for row in range(ROWS)])
    times = entities["/said/steering/predicted_by/first"]["since start"]
    assert [round(time.total_seconds() * 1e9) for time in times if time] == [
        row * STEP_NS for row in range(1, ROWS)
    ]
    names = view_names(tmp_path / "x.rrd")
    assert {"said: steering, -1 left .. 1 right", "said: error in degrees: predicted - recorded"} <= names


def test_logs_of_one_name_are_reported_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    first, second = Path("one", "run.mcap"), Path("two", "run.mcap")
    assert names_of([first, second, Path("a.mcap")]) == ["one/run", "two/run", "a"]
    entities = shown(tmp_path / "x.rrd", write_drive(first), write_drive(second))
    assert len(values(entities, "/one\\/run/steering/recorded")) == ROWS
    assert len(values(entities, "/two\\/run/steering/recorded")) == ROWS


def test_what_cannot_be_compared_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive, still = write_drive(tmp_path / "a.mcap"), write_drive(tmp_path / "still.mcap", poses=False)
    with LogWriter(tmp_path / "far.mcap", {}) as far:
        far.pose(START_NS, 0, pose_message(Pose(5e3, 5e3, 0.0, 0.0, 0.0, 0.0), START_NS))
    for words, message, code in (
        ((drive, still, "--by", "place"), f"{still}: has no poses", 1),
        (
            (drive, tmp_path / "far.mcap", "--by", "place"),
            f"{tmp_path / 'far.mcap'}: not on the road of {drive}",
            1,
        ),
        ((drive, "--by", "place"), "give more than one", 2),
        ((drive, tmp_path / "none.mcap"), "none.mcap: cannot be opened", 1),
        ((drive, tmp_path), "is a folder", 1),
        ((*[drive] * 7,), "at most 6", 1),
        ((drive, drive, "--follow"), "only with one log", 2),
        ((drive, drive, "--web"), "--save writes a file and opens nothing", 2),
    ):
        assert call(main, *words, "--save", tmp_path / "x.rrd") == code, message
        (line,) = capsys.readouterr().err.splitlines()
        assert message in line
    assert not list(tmp_path.glob("*.rrd*"))


# Places


def test_a_road_that_comes_near_itself_is_not_jumped_across() -> None:
    """There and back, 5 m aside: who drives there is not placed on the way back."""
    out = np.stack([np.arange(0.0, 200.0), np.zeros(200)], axis=1)
    back = np.stack([np.arange(199.0, -1.0, -1.0), np.full(200, 5.0)], axis=1)
    way = np.concatenate([out, back])
    placed = distances_along(way, way + np.array((0.0, 3.0)))  # nearer to the way back
    assert placed is not None
    assert np.all(np.diff(placed) >= 0)
    assert placed[150] == pytest.approx(150, abs=1)


def test_another_road_from_the_same_start_is_refused() -> None:
    """It leaves to the side, comes back to where the way ends, and goes on from there for long."""
    way = np.stack([np.arange(0.0, 300.0), np.zeros(300)], axis=1)
    angle = np.linspace(np.pi, 0, 300)
    bend = 150 * np.stack([1 + np.cos(angle), np.sin(angle)], axis=1)
    on = np.stack([np.arange(300.0, 1500.0), np.zeros(1200)], axis=1)
    assert distances_along(way, np.concatenate([bend, on])) is None
    assert distances_along(way, way + np.array((0.0, 4.0))) is not None  # the same road, on its other side
