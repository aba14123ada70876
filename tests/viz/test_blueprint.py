"""The layout: a view with a name for everything that is drawn, and none that would stay empty."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun.blueprint as rrb

from common.car import CAMERAS
from recorder import LogWriter
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.log.writer import pose_message
from recorder.topics import EVENTS, PILOT_COMMAND, PILOT_INPUT, POSE, VEHICLE, camera_topic, prediction_topic
from simulator.pose import Pose
from tests.helpers.driving import road_jpeg
from tests.helpers.logs import START_NS, STEP_NS
from tests.helpers.rrd import contents, view_names
from viz import save_rrd
from viz.playback.blueprint import log_layout

ROWS = 60
TOPICS = (
    *map(camera_topic, CAMERAS),
    VEHICLE,
    PILOT_INPUT,
    PILOT_COMMAND,
    POSE,
    EVENTS,
    prediction_topic("first"),
)
DRAWN = ("Scalars:scalars", "EncodedImage:blob", "TextLog:text", "BarChart:values", "StateChange:state",
         "LineStrips2D:strips", "Arrows2D:vectors")  # fmt: skip


def views(part: Any) -> Iterator[rrb.View]:
    if isinstance(part, rrb.View):
        yield part
    else:
        for inner in part.contents:
            yield from views(inner)


def views_of(layout: rrb.Blueprint) -> list[rrb.View]:
    return list(views(layout.root_container))


def write_drive(path: Path) -> Path:
    """All that a drive's log holds: a quarter of a circle to the left, whose second half a human drives."""
    with LogWriter(path, {"source": "test"}) as log:
        for row in range(ROWS):
            time_ns = START_NS + row * STEP_NS
            for side, camera in enumerate(CAMERAS):
                log.picture(camera, time_ns, row, road_jpeg(row + side))
            log.vehicle(time_ns, row, VehicleState(steering=-0.5 if row < 45 else 0.02, speed_mph=9.0))
            log.crop(time_ns, row, road_jpeg(row))
            driver = PilotCommand.PILOT if row < ROWS // 2 else PilotCommand.HUMAN
            log.command(
                time_ns, row, PilotCommand(predicted_steering=1.0, steering=0.5, driver=driver, total_ms=3)
            )
            angle = math.pi / 2 * row / ROWS
            pose = Pose(100 * math.sin(angle), 100 - 100 * math.cos(angle), 0.0, angle, 0.0, 0.0)
            log.pose(time_ns, row, pose_message(pose, time_ns))
        log.event(START_NS, "connected")
    return path


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("layout")
    save_rrd(write_drive(folder / "drive.mcap"), folder / "drive.rrd")
    return folder / "drive.rrd"


# Views


def test_everything_that_is_drawn_is_in_a_view_and_no_view_is_empty(drive: Path) -> None:
    entities = contents(drive)
    drawn = {entity for entity, columns in entities.items() if set(DRAWN) & columns.keys()}
    origins = {str(view.origin) for view in views_of(log_layout(TOPICS[:-1]))}
    inside = {origin: {path for path in drawn if f"{path}/".startswith(f"{origin}/")} for origin in origins}
    assert all(inside.values()), inside
    assert set().union(*inside.values()) == drawn
    assert view_names(drive) == {view.name for view in views_of(log_layout(TOPICS[:-1]))}


# What is drawn


def test_the_histogram_has_the_frames_of_each_steering(drive: Path) -> None:
    (bars,) = contents(drive)["/histogram/recorded"]["BarChart:values"]
    counts = list(bars[0]["buffer"])
    expected = [0] * 25
    expected[int((-0.5 + 1) / 2 * 25)] = 45
    expected[12] = 15  # straight on is in the middle
    assert counts == expected


def test_arcs_bend_to_where_the_car_is_steered(drive: Path) -> None:
    entities = contents(drive)
    for name, first, last in (("recorded", -0.5, 0.02), ("predicted", 1.0, 1.0), ("sent", 0.5, 0.5)):
        strips = entities[f"/camera/center/steering/{name}"]["LineStrips2D:strips"]
        arcs = [np.array(strip[0]) for strip in strips if strip]
        assert len(arcs) == ROWS
        for arc, steering in ((arcs[0], first), (arcs[-1], last)):
            assert arc[0] == pytest.approx((160, 152))  # the middle of the bottom of 320 x 160
            assert np.sign(arc[-1, 0] - 160) == np.sign(steering)
            assert abs(arc[-1, 0] - 160) == pytest.approx(abs(steering) * 144, rel=1e-4)
            assert arc[:, 1].tolist() == sorted(arc[:, 1], reverse=True)


def test_who_drives_is_reported_where_that_changes(drive: Path) -> None:
    driver = contents(drive)["/driver"]
    states = [state[0] for state in driver["StateChange:state"] if state]
    assert states == ["pilot", "human"]
    assert driver["message_log_time"] == [START_NS, START_NS + ROWS // 2 * STEP_NS]


def test_the_path_from_above_is_the_way_that_was_driven(drive: Path) -> None:
    """North is up: in a picture, y points down."""
    entities = contents(drive)
    (way,) = [strip[0] for strip in entities["/path/driven"]["LineStrips2D:strips"] if strip]
    assert way[0] == pytest.approx((0, 0))
    radius_m = np.hypot(np.array(way)[:, 0], np.array(way)[:, 1] + 100)
    assert radius_m == pytest.approx(100, abs=0.01)
    car = entities["/path/car"]
    origins, vectors = ([end[0] for end in car[f"Arrows2D:{part}"] if end] for part in ("origins", "vectors"))
    assert len(origins) == len(vectors) == ROWS
    assert vectors[0] == pytest.approx((8, 0))  # to the east
    angle = math.pi / 2 * (ROWS - 1) / ROWS
    assert origins[-1] == pytest.approx((100 * math.sin(angle), 100 * math.cos(angle) - 100), abs=1e-3)
    assert vectors[-1] == pytest.approx((8 * math.cos(angle), -8 * math.sin(angle)), abs=1e-3)
