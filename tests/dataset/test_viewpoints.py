"""Views from beside the line for training: what is seen there, and labels that bring the car back."""

from __future__ import annotations

import math
from pathlib import Path

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
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log.car_geometry import UDACITY

ROWS = 60
MPS = 0.44704  # metres a second in a mile an hour
SPEED_MPH = 20.0


def png(camera: Camera, width_px: int) -> bytes:
    ok, encoded = cv2.imencode(".png", render(UDACITY, beside_m=UDACITY.left_m[camera], width_px=width_px))
    assert ok
    return encoded.tobytes()


def record(path: Path, source: str = "udacity", speed_mph: float = SPEED_MPH, width_px: int = 320) -> Path:
    pictures = {camera: png(camera, width_px) for camera in CAMERAS}
    with LogWriter(path, {"source": source}) as writer:
        for row in range(ROWS):
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


def test_each_training_picture_of_the_centre_camera_gives_views_and_no_other(tmp_path: Path, log: Path) -> None:
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


def test_a_view_shows_what_a_camera_there_would_see(tmp_path: Path, log: Path) -> None:
    """Also mirrored: then it is the view from the other side of a mirrored road."""
    index = build_index([log], tmp_path / "index", IndexConfig(viewpoints=1, alter=("none",))).path
    samples = pq.read_table(index / "samples.parquet")
    train = samples.filter(pc.equal(samples["split"], "train"))
    chosen = [row for row, name in enumerate(train["alteration"].to_pylist()) if name == "viewpoint"][:12]
    with load(index, batch=1) as loader:
        for row in chosen:
            left_m, turn_rad = place(train["seed"][row].as_py())
            is_flipped = train["flip"][row].as_py()
            sign = -1 if is_flipped else 1
            there = preprocess(render(UDACITY, left_m=sign * left_m, turn_rad=sign * turn_rad))
            expected = there[:, ::-1] if is_flipped else there
            middle = slice(24, 104)  # what a camera that looked straight ahead has seen
            shown = loader.pictures_of(np.array([row]))[0]
            assert np.abs(shown[:100, middle].astype(float) - expected[:100, middle]).mean() < 4


def test_labels_begin_the_way_back_to_the_line_and_its_direction_in_two_seconds(tmp_path: Path, log: Path) -> None:
    """The way that bends least is a cubic (a spline): the label's bend, less the line's own, is how it begins."""
    samples = build_index([log], tmp_path / "index", IndexConfig(viewpoints=1, flip=False)).samples
    views = samples.filter(pc.starts_with(samples["alteration"], "viewpoint"))
    way_m = 2 * SPEED_MPH * MPS

    def bend(steering: float) -> float:
        return math.tan(math.radians(25) * steering) / UDACITY.wheelbase_m

    columns = (views[name].to_pylist() for name in ("seed", "label", "recorded"))
    for seed, label, recorded in zip(*columns, strict=True):
        left_m, turn_rad = place(seed)
        # left_m + turn_rad x + a x² + b x³, which is 0 after way_m, and so is its slope
        ends = [[way_m**2, way_m**3], [2 * way_m, 3 * way_m**2]]
        a, _ = np.linalg.solve(ends, [-left_m - turn_rad * way_m, -turn_rad])
        assert bend(label) - bend(recorded) == pytest.approx(-2 * a, abs=1e-9)  # to the right


def test_where_the_speed_is_not_known_or_the_camera_no_label_comes_out_of_nothing(tmp_path: Path) -> None:
    for name, speed_mph in (("unknown", math.nan), ("slow", 2.0)):
        log = record(tmp_path / f"{name}.mcap", speed_mph=speed_mph)
        samples = build_index([log], tmp_path / name, IndexConfig(viewpoints=1)).samples
        assert not any(word.startswith("viewpoint") for word in samples["alteration"].to_pylist())
    tub = record(tmp_path / "tub.mcap", source="donkeycar")
    with pytest.raises(DatasetError, match=r"--viewpoints.*tub\.mcap.*where its cameras stand"):
        build_index([tub], tmp_path / "tub", IndexConfig(viewpoints=1))
    build_index([tub], tmp_path / "tub", IndexConfig())
    with pytest.raises(ValueError, match="--viewpoints -1"):
        IndexConfig(viewpoints=-1)


def test_what_cannot_be_warped_is_refused_before_anything_is_built(tmp_path: Path) -> None:
    """A crop does not tell how much of the world it shows to either side."""
    upright = record(tmp_path / "upright.mcap", width_px=200)
    with pytest.raises(DatasetError, match=r"--viewpoints.*upright\.mcap.*200 x 160 px.*twice as wide as high"):
        build_index([upright], tmp_path / "index", IndexConfig(viewpoints=1))
    assert not (tmp_path / "index" / "samples.parquet").exists()
    with pytest.raises(ValueError, match=r"--cameras left right.*center.*--viewpoints"):
        IndexConfig(viewpoints=1, cameras=("left", "right"))


def test_other_alterations_come_on_top_and_the_same_seed_gives_the_same_picture(log: Path) -> None:
    crop = preprocess(render(UDACITY))
    seed = (123 << 32) | 0xC000_2000
    assert (alter(crop, "viewpoint+blur", seed) == alter(crop, "viewpoint+blur", seed)).all()
    view = alter(crop, "viewpoint", seed)
    assert (view == alter(crop, "viewpoint", (77 << 32) | 0xC000_2000)).all()
    assert (alter(crop, "viewpoint+blur", seed) == alter(view, "blur", seed)).all()
