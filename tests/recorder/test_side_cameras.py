"""`bc-log cameras`: how far the side cameras are, measured in pictures whose cameras' places are known."""

from __future__ import annotations

import functools
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

import simulator.rendering.camera
from common.car import CAMERAS
from driving import road_jpeg
from recorder import LogWriter, RecordingError
from recorder.bc_pb2 import VehicleState
from recorder.log.reader import Log
from recorder.log.session_car import UDACITY, Car, built_in
from recorder.log_cli import main as log_main
from recorder.sources.built_in_simulator import record_simulated
from recorder.sources.settings import SimulatedDrive
from recorder.upkeep.side_cameras import Gray, SideCameras, measure, side_cameras
from simulator.driving.simulation import Simulation
from udacity import call


@functools.cache
def lake() -> Simulation:
    """It takes half a second to build."""
    return Simulation("lake")


def moments(count: int = 6) -> list[list[Gray | None]]:
    """What the three cameras see in as many places of the lake."""
    return [[decoded(np.frombuffer(jpeg, np.uint8)) for jpeg in of_place] for of_place in jpegs(count)]


def jpegs(count: int) -> list[list[bytes]]:
    result: list[list[bytes]] = []
    for number in range(count):
        lake().course.start(number * lake().track.line.length_m / count)
        result.append([lake().jpeg(camera) for camera in CAMERAS])
    return result


def decoded(jpeg: Gray) -> Gray:
    picture = cv2.imdecode(jpeg, cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    return picture.astype(np.uint8)


@pytest.mark.parametrize(("apart_m", "high_m"), [(0.36, 1.4), (0.9, 1.4), (1.2, 1.4), (0.5, 1.0)])
def test_it_is_that_of_the_cameras_that_took_the_pictures(
    apart_m: float, high_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(simulator.rendering.camera.MOUNT_LEFT_M, "left", apart_m)
    monkeypatch.setitem(simulator.rendering.camera.MOUNT_LEFT_M, "right", -apart_m)
    monkeypatch.setattr(simulator.rendering.camera, "MOUNT_UP_M", high_m)
    found = measure(moments())
    true = apart_m / high_m * math.cos(simulator.rendering.camera.MOUNT_PITCH_RAD)
    assert found.left == pytest.approx(true, abs=0.015)
    assert found.right == pytest.approx(true, abs=0.015)
    assert found.moments == 6


@pytest.mark.parametrize("size", [(640, 320), (160, 80)])
def test_the_size_of_the_pictures_does_not_matter(size: tuple[int, int]) -> None:
    others: list[list[Gray | None]] = [
        [cv2.resize(p, size, interpolation=cv2.INTER_AREA).astype(np.uint8) for p in each if p is not None]
        for each in moments()
    ]
    assert measure(others).spacing == pytest.approx(0.63, abs=0.02)


def test_sides_that_are_swapped_are_found_by_a_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, order in (("sound", CAMERAS), ("swapped", ("center", "right", "left"))):
        with LogWriter(tmp_path / f"{name}.mcap", {"source": "test"}) as writer:
            for row, of_place in enumerate(jpegs(6) * 4):
                by_camera = dict(zip(CAMERAS, of_place, strict=True))
                for camera, shown in zip(CAMERAS, order, strict=True):
                    writer.picture(camera, row * 10**8, row, by_camera[shown])
                writer.vehicle(row * 10**8, row, VehicleState(steering=row / 100, speed_mph=9.0))
    assert call(log_main, "check", tmp_path / "sound.mcap") == 0
    assert "side cameras" not in capsys.readouterr().out
    assert call(log_main, "check", tmp_path / "swapped.mcap") == 3
    assert (
        "side cameras that are swapped: 1 (left and right; `bc-index --cameras center`" in capsys.readouterr().out
    )


def test_cameras_at_two_distances_have_no_one_correction(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(simulator.rendering.camera.MOUNT_LEFT_M, "right", -0.5)
    with pytest.raises(
        ValueError, match=r"left camera is 0\.6\d of its height .* right one 0\.3\d: one correction"
    ):
        measure(moments())


def test_pictures_that_tell_nothing_are_refused() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (5, 3, 160, 320), dtype=np.uint8)
    with pytest.raises(ValueError, match="do not fit"):
        measure([list(each) for each in noise])
    same = [[each[0], each[0], each[0]] for each in moments(3)]  # a recorder that keeps one camera's three times
    with pytest.raises(ValueError, match="do not fit"):
        measure(same)
    with pytest.raises(ValueError, match="do not fit"):  # left and right exchanged
        measure([[centre, right, left] for centre, left, right in moments(3)])
    black = np.zeros((160, 320), np.uint8)
    with pytest.raises(ValueError, match="do not fit"):
        measure([[black, black, black]])
    nothing: list[list[list[Gray | None]]] = [[], [[black, None, black]], [[black, black, black[:80]]]]
    for each_moments in nothing:
        with pytest.raises(ValueError, match="no moment has whole pictures"):
            measure(each_moments)
    with pytest.raises(ValueError, match="high enough"):
        measure([[black[:9]] * 3])


def test_the_command_names_the_flag_of_bc_index(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = record_simulated(SimulatedDrive(laps=0.006), tmp_path / "lake.mcap").path
    assert call(log_main, "cameras", log) == 0
    told = capsys.readouterr().out
    assert told.startswith(f"{log}: each side camera is 0.6")
    # the wheels are nearer to each other than Udacity's, and the cameras as far from the middle
    assert "moments: `bc-index --side-correction 0.2" in told
    assert told.endswith(", 0.18 at 10 mph\n")


@pytest.mark.parametrize(("speed_mph", "steers"), [(10, 0.24), (15, 0.17), (20, 0.13)])
def test_faster_cars_are_led_back_as_much_less_as_an_expert_does(speed_mph: float, steers: float) -> None:
    """That of the built-in simulator, put 0.9 m beside the line (docs/commands.md)."""
    cameras = SideCameras(0.9 / built_in().height_m, 0.9 / built_in().height_m, 60)
    share = cameras.side_correction(built_in(), speed_mph) / cameras.side_correction(built_in(), 10)
    assert share == pytest.approx(steers / 0.24, abs=0.05)


def test_a_fast_car_of_another_lock_is_led_back_as_its_expert_does() -> None:
    """In TORCS at 30 mph an expert steers 0.067 there; 0.22 was recommended."""
    cameras = SideCameras(0.69, 0.69, 60)
    car = Car(max_steering_deg=23.0, wheelbase_m=2.6, height_m=1.35)
    assert cameras.side_correction(car, 30.0) == pytest.approx(0.067, abs=0.01)


def test_a_log_of_an_unknown_car_is_said_to_be_taken_for_udacitys(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with LogWriter(tmp_path / "x.mcap", {"source": "telemetry of somebody"}) as writer:
        for row, pictures in enumerate(jpegs(3)):
            for camera, jpeg in zip(CAMERAS, pictures, strict=True):
                writer.picture(camera, row, row, jpeg)
            writer.vehicle(row, row, VehicleState(speed_mph=31.0 if row else 0.0))
    assert call(log_main, "cameras", tmp_path / "x.mcap") == 0
    told = capsys.readouterr().out
    assert "`bc-index --side-correction 0.06` leads back at 31 mph" in told
    assert "0.2 at 10 mph, if its car is as Udacity's" in told


def test_a_log_without_side_cameras_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with LogWriter(tmp_path / "x.mcap", {"source": "telemetry"}) as writer:
        writer.picture("center", 0, 0, road_jpeg(0))
        writer.vehicle(0, 0, VehicleState())
    assert call(log_main, "cameras", tmp_path / "x.mcap") == 1
    assert "x.mcap: no moment has pictures of all three cameras" in capsys.readouterr().err
    with Log(tmp_path / "x.mcap") as log, pytest.raises(RecordingError):
        side_cameras(log)


@pytest.mark.parametrize("name", ["jungle_linux", "lake_14hz", "lake_windows", "mountain_linux"])
def test_udacitys_cameras_have_udacitys_correction(name: str, recordings: Path) -> None:
    images = recordings / name / "IMG"
    centres = sorted(images.glob("center_*.jpg"))
    found = measure(
        [
            [decoded(np.fromfile(images / path.name.replace("center", camera), np.uint8)) for camera in CAMERAS]
            for path in centres[:: len(centres) // 30]
        ]
    )
    assert found.side_correction(UDACITY, 10.0) == pytest.approx(0.2, abs=0.011)
