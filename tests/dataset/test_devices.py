"""The device that a person steers with: in a log's rows, in the index's frames, and in the plan of its labels."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from dataset import build_index
from recorder.bc_pb2 import VehicleState
from recorder.log.writer import LogWriter
from recorder.upkeep.log_info import describe
from tests.helpers.logs import START_NS, STEP_NS

Devices = list["VehicleState.Device"]


def steered(path: Path, devices: Devices, unfinished: Path | None = None) -> Path:
    """A log of a row for each device, a tenth of a second apart; a copy of it before its end is `unfinished`."""
    with LogWriter(path, {"source": "simulator", "driver": "human"}, live=True) as writer:
        for row, device in enumerate(devices):
            time_ns = START_NS + row * STEP_NS
            writer.picture("center", time_ns, row, f"{row}".encode())
            state = VehicleState(steering=0.1 * (row % 3), throttle=0.5, speed_mph=9.0, device=device)
            writer.vehicle(time_ns, row, state)
        if unfinished is not None:
            shutil.copy(writer.part, unfinished)
    return path


def plan_of(index: Path, session: str) -> dict[str, object]:
    stored = json.loads(pq.read_schema(index / "samples.parquet").metadata[b"bc.index"])
    plan: dict[str, object] = stored["labels"][session]["plan"]
    return plan


def test_the_index_has_the_device_of_each_frame(tmp_path: Path) -> None:
    log = steered(tmp_path / "a.mcap", [VehicleState.KEYBOARD, VehicleState.UNKNOWN, VehicleState.TOUCH])
    build_index([log], tmp_path / "index")
    frames = pq.read_table(tmp_path / "index" / "frames" / "a.parquet")
    assert frames["device"].to_pylist() == ["keyboard", "", "touch"]


@pytest.mark.parametrize(
    ("device", "smooth_s", "shift_s"),
    [
        (VehicleState.KEYBOARD, 0.5, 0.2),
        (VehicleState.MOUSE, 0.5, 0.2),
        (VehicleState.GAMEPAD, 0.0, 0.0),
        (VehicleState.TOUCH, 0.0, 0.0),
    ],
)
def test_labels_go_by_the_device_that_is_recorded(
    tmp_path: Path, device: VehicleState.Device, smooth_s: float, shift_s: float
) -> None:
    build_index([steered(tmp_path / "a.mcap", [device] * 100)], tmp_path / "index")
    plan = plan_of(tmp_path / "index", "a")
    assert (plan["smooth_s"], plan["shift_s"], plan["without_crashes"]) == (smooth_s, shift_s, True)
    assert not (tmp_path / "index" / "lags").exists()  # no picture was looked at: these are none


def test_labels_go_by_the_device_of_most_rows(tmp_path: Path) -> None:
    devices = [VehicleState.KEYBOARD] * 40 + [VehicleState.GAMEPAD] * 60 + [VehicleState.UNKNOWN] * 200
    build_index([steered(tmp_path / "a.mcap", devices)], tmp_path / "index")
    assert plan_of(tmp_path / "index", "a")["why"] == "gamepad"


def test_what_describes_a_log_names_the_device(tmp_path: Path) -> None:
    info = describe(steered(tmp_path / "a.mcap", [VehicleState.MOUSE] * 100))
    assert info.driver == "human (mouse)"
    assert info.labels == "mean of 0.5 s, 0.2 s later (mouse)"
