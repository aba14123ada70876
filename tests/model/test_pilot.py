"""The pilot: what a run's network says of a picture, in float32 and in bfloat16."""

from __future__ import annotations

import math
import platform
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from dataset import decode
from dataset.preprocessing import Image
from model import Pilot, load_pilot
from model.network.pilotnet import SteeringNetwork
from model.runs.run_folder import load_network
from tests.helpers.driving import Process, road_jpeg, untrained_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return untrained_run(tmp_path_factory.mktemp("runs") / "untrained", seed=3, network="original")


@pytest.fixture(scope="module")
def crops(run: Path) -> list[Image]:
    pilot = load_pilot(run)
    return [pilot.crop(decode(road_jpeg(number))) for number in range(6)]


def as_trained(run: Path, crops: list[Image]) -> list[float]:
    """By the network as it is, all pictures at once and in the plainest layout of the data."""
    network = load_network(run).eval()
    with torch.no_grad():
        return network(torch.from_numpy(np.stack(crops).transpose(0, 3, 1, 2).copy())).tolist()  # type: ignore[no-any-return]


def test_float32_reports_what_the_trained_network_says(run: Path, crops: list[Image]) -> None:
    pilot = load_pilot(run, "float32")
    assert pilot.arithmetic == "float32"
    assert [pilot.predict(crop) for crop in crops] == pytest.approx(as_trained(run, crops), abs=1e-5)


def test_bfloat16_reports_nearly_the_same(run: Path, crops: list[Image]) -> None:
    """To a quarter of a degree."""
    pilot = load_pilot(run, "bfloat16")
    assert pilot.arithmetic == "bfloat16"
    printed, exact = [pilot.predict(crop) for crop in crops], as_trained(run, crops)
    assert printed != pytest.approx(exact, abs=1e-6)  # it is really calculated otherwise
    assert printed == pytest.approx(exact, abs=0.01)


def test_by_default_it_is_one_of_the_two_and_reports_which(run: Path, crops: list[Image]) -> None:
    pilot = load_pilot(run)
    asked = load_pilot(run, "bfloat16" if pilot.arithmetic == "bfloat16" else "float32")
    assert [pilot.predict(crop) for crop in crops] == [asked.predict(crop) for crop in crops]


@pytest.mark.skipif(
    platform.machine() not in ("x86_64", "AMD64"), reason="needs a processor that can hide bfloat16"
)
def test_without_packed_weights_it_drives_all_the_same(tmp_path: Path) -> None:
    """oneDNN is told to go by an older processor, which has no bfloat16: it refuses to pack the weights."""
    run = untrained_run(tmp_path / "run")
    pilot = load_pilot(run, "bfloat16")
    crop = pilot.crop(decode(road_jpeg(0)))
    np.save(tmp_path / "crop.npy", crop)
    program = """
import os, pathlib, sys
os.environ["ONEDNN_MAX_CPU_ISA"] = "AVX2"  # read when oneDNN is first asked for something
import numpy as np
from model import load_pilot
from model.network.faster_layers import pack_weights
from model.runs.run_folder import load_network

run, crop = map(pathlib.Path, sys.argv[1:])
assert not pack_weights(load_network(run).bfloat16().head)
print(load_pilot(run, "bfloat16").predict(np.load(crop)))
"""
    line = [sys.executable, "-c", program, str(run), str(tmp_path / "crop.npy")]
    with Process(line) as older:
        assert older.join() == 0, older.stderr
    assert float(older.stdout) == pytest.approx(pilot.predict(crop), abs=0.01)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("broken", [math.nan, math.inf])
def test_weights_that_are_no_numbers_are_reported_and_not_raised(dtype: torch.dtype, broken: float) -> None:
    network = SteeringNetwork()
    with torch.no_grad():
        network.features[0].weight.fill_(broken)  # type: ignore[operator]
    pilot = Pilot(network, dtype=dtype)
    assert not math.isfinite(pilot.predict(np.full((128, 128, 3), 200, np.uint8)))
