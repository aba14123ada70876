"""Views from beside the line for training: what is seen there, and labels that bring the car back."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from common.car import CAMERAS, Camera
from dataset import DatasetError, IndexConfig, build_index, load, preprocess
from dataset.augment import alter
from logs import START_NS
from painted_road import render
from recorder import Log, LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log.session_car import UDACITY, Car, built_in, metadata_of
from recorder.sources.built_in_simulator import record_simulated
from recorder.sources.settings import SimulatedDrive
from recorder.topics import POSE
from simulator.driving.simulation import Simulation
from simulator.pose import Pose

ROWS = 60
MPS = 0.44704  # metres a second in a mile an hour
SPEED_MPH = 20.0


OTHER_CAR = Car(
    max_steering_deg=40.0,
    wheelbase_m=1.8,
    focal=1.2,
    horizon=0.42,
    height_m=0.8,
    forward_m=-0.3,
    left_m={"left": 0.4, "right": -0.4},
    bonnet={},
)


NARROW_CAR = replace(UDACITY, wheelbase_m=2.0)


def png(camera: Camera, width_px: int, car: Car = UDACITY) -> bytes:
    ok, encoded = cv2.imencode(".png", render(car, beside_m=car.left_m[camera], width_px=width_px))
    assert ok
    return encoded.tobytes()


def record(
    path: Path,
    source: str = "udacity",
    speed_mph: float = SPEED_MPH,
    width_px: int = 320,
    car: Car | None = None,
    rows: int = ROWS,
) -> Path:
    pictures = {camera: png(camera, width_px, car or UDACITY) for camera in CAMERAS}
    with LogWriter(path, {"source": source} | metadata_of(car)) as writer:
        for row in range(rows):
            time_ns = START_NS + row * 100_000_000
            for camera in CAMERAS:
                writer.picture(camera, time_ns, row, pictures[camera])
            state = VehicleState(steering=0.3 * math.sin(row / 5), throttle=0.5, brake=0.0, speed_mph=speed_mph)
            writer.vehicle(time_ns, row, state)
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("views") / "road.mcap")


def place(seed: int) -> tuple[float, float]:
    """Metres to the left and rad to the left, as docs/index-format.md says how a seed names them."""
    across, turned = seed & 0xFFFF, seed >> 16 & 0xFFFF
    return 0.8 * (2 * across / 65535 - 1), math.radians(6) * (2 * turned / 65535 - 1)


def test_each_training_picture_of_the_centre_gives_views_and_no_other(tmp_path: Path, log: Path) -> None:
    config = IndexConfig(balance=False, viewpoints=2, block_s=1.0, gap_s=0.0)
    samples = build_index([log], tmp_path / "index", config).samples
    views = samples.filter(pc.starts_with(samples["alteration"], "viewpoint"))
    plain = samples.filter(pc.equal(samples["alteration"], ""))
    seen = plain.filter(pc.and_(pc.equal(plain["camera"], "center"), pc.equal(plain["split"], "train")))
    assert len(views) == 2 * len(seen)
    assert set(views["camera"].to_pylist()) == {"center"}
    assert set(views["split"].to_pylist()) == {"train"}
    assert all(views["copy"].to_pylist())
    without = build_index([log], tmp_path / "without", IndexConfig(balance=False, block_s=1.0, gap_s=0.0)).samples
    assert plain.equals(without)


def test_the_same_inputs_give_the_same_bytes_and_another_seed_other_views(tmp_path: Path, log: Path) -> None:
    def built(name: str, seed: int) -> bytes:
        build_index([log], tmp_path / name, IndexConfig(viewpoints=1, seed=seed))
        return (tmp_path / name / "samples.parquet").read_bytes()

    assert built("one", 0) == built("two", 0)
    assert built("three", 1) != built("one", 0)


@pytest.mark.parametrize(("car", "width_px"), [(UDACITY, 320), (UDACITY, 200), (OTHER_CAR, 320), (OTHER_CAR, 200)])
def test_a_view_shows_what_a_camera_there_would_see(tmp_path: Path, car: Car, width_px: int) -> None:
    """Also mirrored: then it is the view from the other side of a mirrored road."""
    told = None if car == UDACITY else car
    log = record(tmp_path / "road.mcap", width_px=width_px, car=told, rows=20)
    config = IndexConfig(viewpoints=1, alter=("none",), validation_share=0.0)
    index = build_index([log], tmp_path / "index", config).path
    samples = pq.read_table(index / "samples.parquet")
    train = samples.filter(pc.equal(samples["split"], "train"))
    chosen = [row for row, name in enumerate(train["alteration"].to_pylist()) if name == "viewpoint"][:12]
    with load(index, batch=1) as loader:
        for row in chosen:
            left_m, turn_rad = place(train["seed"][row].as_py())
            is_flipped = train["flip"][row].as_py()
            sign = -1 if is_flipped else 1
            there = preprocess(render(car, left_m=sign * left_m, turn_rad=sign * turn_rad, width_px=width_px))
            expected = there[:, ::-1] if is_flipped else there
            middle = slice(24, 104)  # what a camera that looked straight ahead has seen
            shown = loader.pictures_of(np.array([row]))[0]
            assert np.abs(shown[:100, middle].astype(float) - expected[:100, middle]).mean() < 4


@pytest.mark.parametrize("car", [UDACITY, OTHER_CAR])
def test_labels_begin_the_way_back_in_two_seconds(tmp_path: Path, car: Car) -> None:
    """The way that bends least is a cubic (a spline): the label's bend, less the line's own, is how it begins."""
    log = record(tmp_path / "road.mcap", car=None if car == UDACITY else car)
    samples = build_index([log], tmp_path / "index", IndexConfig(viewpoints=1, flip=False)).samples
    views = samples.filter(pc.starts_with(samples["alteration"], "viewpoint"))
    way_m = 2 * SPEED_MPH * MPS

    def bend(steering: float) -> float:
        return math.tan(math.radians(car.max_steering_deg) * steering) / car.wheelbase_m

    columns = (views[name].to_pylist() for name in ("seed", "label", "recorded"))
    for seed, label, recorded in zip(*columns, strict=True):
        left_m, turn_rad = place(seed)
        # left_m + turn_rad x + a x² + b x³, which is 0 after way_m, and so is its slope
        ends = [[way_m**2, way_m**3], [2 * way_m, 3 * way_m**2]]
        a, _ = np.linalg.solve(ends, [-left_m - turn_rad * way_m, -turn_rad])
        assert bend(label) - bend(recorded) == pytest.approx(-2 * a, abs=1e-9)  # to the right


def test_without_speed_or_camera_no_label_comes_out(tmp_path: Path) -> None:
    for name, speed_mph in (("unknown", math.nan), ("slow", 2.0)):
        log = record(tmp_path / f"{name}.mcap", speed_mph=speed_mph)
        samples = build_index([log], tmp_path / name, IndexConfig(viewpoints=1)).samples
        assert not any(word.startswith("viewpoint") for word in samples["alteration"].to_pylist())
    tub = record(tmp_path / "tub.mcap", source="donkeycar")
    with pytest.raises(DatasetError, match=r"--viewpoints.*tub\.mcap.*does not describe its cameras"):
        build_index([tub], tmp_path / "tub", IndexConfig(viewpoints=1))
    build_index([tub], tmp_path / "tub", IndexConfig())
    with pytest.raises(ValueError, match="--viewpoints -1"):
        IndexConfig(viewpoints=-1)


def test_each_session_of_an_index_has_the_car_of_its_own(tmp_path: Path) -> None:
    """Udacity's, another, and the built-in simulator's, whose views are what it renders there: on the lake, which
    begins level."""
    record_simulated(SimulatedDrive(laps=0.01), tmp_path / "lake.mcap")
    other = replace(OTHER_CAR, max_steering_deg=25.0)
    cars = {"road": UDACITY, "other": other, "lake": built_in()}
    record(tmp_path / "road.mcap")
    record(tmp_path / "other.mcap", car=other)
    config = IndexConfig(viewpoints=1, alter=("none",), validation_share=0.0, flip=False, balance=False)
    logs = [tmp_path / f"{name}.mcap" for name in cars]
    index = build_index(logs, tmp_path / "index", config).path
    views = pq.read_table(index / "samples.parquet").to_pylist()
    simulation = Simulation("lake")
    with Log(tmp_path / "lake.mcap") as log:
        poses = {message.sequence: each.pose for message, each in log.decoded(POSE)}
        states = log.vehicle()
    speeds = {name: dict.fromkeys(range(ROWS), SPEED_MPH) for name in ("road", "other")}
    speeds["lake"] = dict(zip(states["row"].to_pylist(), states["speed_mph"].to_pylist(), strict=True))
    off, unmoved = [], []
    with load(index, batch=1) as loader:
        for number, row in enumerate(views):
            if row["alteration"] != "viewpoint":
                continue
            left_m, turn_rad = place(row["seed"])
            car, way_m = cars[row["session"]], 2 * speeds[row["session"]][row["row"]] * MPS
            bend = np.tan(math.radians(25) * np.array([row["label"], row["recorded"]])) / car.wheelbase_m
            if abs(row["label"]) < 1:
                assert bend[0] - bend[1] == pytest.approx((6 * left_m / way_m + 4 * turn_rad) / way_m, abs=1e-9)
            if row["session"] == "lake" and row["row"] % 3 == 0:
                true = preprocess(simulation.picture("center", beside(poses[row["row"]], left_m, turn_rad)))
                here = preprocess(simulation.picture("center", beside(poses[row["row"]], 0.0, 0.0)))
                near = slice(20, 90), slice(30, 98)  # of the road, without the bonnet and the picture's sides
                shown = loader.pictures_of(np.array([number]))[0]
                off.append(np.abs(shown[near].astype(float) - true[near]).mean())
                unmoved.append(np.abs(here[near].astype(float) - true[near]).mean())
    assert len(off) > 5
    assert np.mean(off) < 0.6 * np.mean(unmoved)


def beside(pose: Any, left_m: float, turn_rad: float) -> Pose:
    heading_rad = 2 * math.atan2(pose.orientation.z, pose.orientation.w)
    at = pose.position
    return Pose(
        at.x - left_m * math.sin(heading_rad), at.y + left_m * math.cos(heading_rad), at.z, heading_rad + turn_rad
    )


def test_each_log_is_opened_once(tmp_path: Path) -> None:
    opened: list[str] = []

    def note(event: str, arguments: tuple[object, ...]) -> None:
        if event == "open" and str(arguments[0]).endswith(".mcap"):
            opened.append(Path(str(arguments[0])).name)

    sys.addaudithook(note)  # stays, and hears nothing of the tests that follow
    logs = [
        record(tmp_path / "one.mcap", car=NARROW_CAR, rows=20),
        record(tmp_path / "two.mcap", width_px=200, rows=20),  # tells no car
    ]
    opened.clear()
    config = IndexConfig(viewpoints=1, labels="as-recorded")
    build_index(logs, tmp_path / "index", config)
    assert sorted(opened) == ["one.mcap", "two.mcap"]
    opened.clear()
    build_index(logs, tmp_path / "index", replace(config, flip=False))
    assert opened == []  # and never where it has not changed


def test_what_cannot_be_warped_is_refused_before_anything_is_built(tmp_path: Path) -> None:
    """A crop does not tell how much of the world it shows to either side: that is of a session, in which all
    pictures are alike."""
    mixed = tmp_path / "mixed.mcap"
    with LogWriter(mixed, {"source": "udacity"}) as writer:
        for row in range(30):
            writer.picture("center", START_NS + row * 100_000_000, row, png("center", 320 - row))
            state = VehicleState(steering=0.0, throttle=0.5, brake=0.0, speed_mph=SPEED_MPH)
            writer.vehicle(START_NS + row * 100_000_000, row, state)
    with pytest.raises(DatasetError, match=r"--viewpoints.*mixed\.mcap.*several sizes"):
        build_index([mixed], tmp_path / "index", IndexConfig(viewpoints=1))
    assert not (tmp_path / "index" / "samples.parquet").exists()
    with pytest.raises(ValueError, match=r"--cameras left right.*center.*--viewpoints"):
        IndexConfig(viewpoints=1, cameras=("left", "right"))


def test_other_alterations_come_on_top_and_a_seed_repeats_them(log: Path) -> None:
    crop = preprocess(render(UDACITY))
    seed = (123 << 32) | 0xC000_2000
    assert (alter(crop, "viewpoint+blur", seed) == alter(crop, "viewpoint+blur", seed)).all()
    view = alter(crop, "viewpoint", seed)
    assert (view == alter(crop, "viewpoint", (77 << 32) | 0xC000_2000)).all()
    assert (alter(crop, "viewpoint+blur", seed) == alter(view, "blur", seed)).all()
