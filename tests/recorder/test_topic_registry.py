"""A new camera and a new topic are data: one entry each in the registry, and a source that provides them.

The rooms are copied with these two entries written into `common/car.py` and `recorder/topics.py`, as a
contributor would write them; a process with the copy on its path then does all that is done with logs.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from tests.helpers.driving import environment
from tests.helpers.logs import read_messages
from tests.helpers.repository import ROOT
from tests.helpers.rrd import contents, view_names
from tests.helpers.waiting import PATIENCE_S

CAMERA = ('"center", "left", "right"]', '"center", "left", "right", "rear"]')
ENTRY = """
        Topic(
            "/imu",
            MessageType("foxglove.Vector3", "foxglove_schemas_protobuf.Vector3_pb2"),
            is_in_order=True,
            lines=(Line("y", Plot("/mps2", "acceleration", "m/s²"), "lateral", "to the left", "violet"),),
        ),
"""
ROWS = 40

SOURCE = f"""
import json, sys
from pathlib import Path
import cv2
import numpy as np
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from common.car import CAMERAS
from dataset import IndexConfig, build_index
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.upkeep.check import check
from recorder.upkeep.edit import merge, trim
from recorder.upkeep.log_info import describe
from recorder.upkeep.recover import recover
from viz import save_rrd
from viz.live.live_log import GrowingLog

def record(path, without=None, imu_row=lambda row: row, start_ns=10**18):
    random = np.random.default_rng(start_ns)
    with LogWriter(path, {{"source": "test"}}) as log:
        for row in range({ROWS}):
            time_ns = start_ns + row * 10**8
            for camera in CAMERAS:
                if (camera, row) != without:
                    picture = cv2.imencode(".jpg", random.integers(0, 255, (40, 80, 3), np.uint8))[1].tobytes()
                    log.picture(camera, time_ns, row, picture)
            log.vehicle(time_ns, row, VehicleState(steering=0.01 * row, throttle=0.5, speed_mph=9.0))
            log.message("/imu", time_ns, imu_row(row), Vector3(x=9.0, y=row / 10, z=-9.8))
    return path

def findings(path):
    return [list(finding) for finding in check(path).findings]

whole = record(Path("sessions/whole.mcap"))
other = record(Path("other.mcap"), start_ns=10**18 + {ROWS} * 10**8)
hurt = record(Path("hurt.mcap"), ("rear", 3), lambda row: 7 if row == 8 else row)
trimmed = trim(whole, Path("trimmed.mcap"), (5, 14)).path
merged = merge([whole, other], Path("merged.mcap")).path
recovered = recover(whole, Path("recovered.mcap")).path
build_index([whole], Path("index"), IndexConfig(cameras=("rear",)))
save_rrd(whole, Path("whole.rrd"))
with GrowingLog(whole) as growing:
    shown = sorted({{message.topic for messages in growing.read() for message in messages}})
results = {{
    "findings": {{path.stem: findings(path) for path in (whole, hurt, trimmed, merged, recovered)}},
    "messages": {{topic.topic: topic.messages for topic in describe(whole).topics}},
    "shown while it grows": shown,
}}
Path("results.json").write_text(json.dumps(results))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where all of it was done."""
    folder = tmp_path_factory.mktemp("registry")
    code = folder / "code"
    for room in ("common", "recorder"):
        shutil.copytree(ROOT / room, code / room, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("simulator", "dataset", "model", "viz", "behavioural_cloning_toolkit.py"):
        (code / name).symlink_to(ROOT / name)
    cameras, topics = code / "common" / "car.py", code / "recorder" / "topics.py"
    cameras.write_text(replaced(cameras.read_text(encoding="utf-8"), *CAMERA), encoding="utf-8")
    last = "\n        Topic(EVENTS,"
    topics.write_text(replaced(topics.read_text(encoding="utf-8"), last, ENTRY.rstrip() + last), encoding="utf-8")
    (folder / "source.py").write_text(SOURCE, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "source.py"],
        cwd=folder,
        env={**environment(), "PYTHONPATH": os.fspath(code)},
        capture_output=True,
        text=True,
        timeout=4 * PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder


def replaced(text: str, old: str, new: str) -> str:
    assert text.count(old) == 1
    return text.replace(old, new)


@pytest.fixture(scope="module")
def results(folder: Path) -> Any:
    return json.loads((folder / "results.json").read_text())


def rows_on(log: Path, topic: str) -> list[int]:
    return [message.sequence for message, _ in read_messages(log)[topic]]


def test_they_are_recorded(folder: Path, results: Any) -> None:
    whole = folder / "sessions" / "whole.mcap"
    for topic in ("/camera/rear", "/imu"):
        assert rows_on(whole, topic) == list(range(ROWS))
        assert results["messages"][topic] == ROWS
    assert [content.y for _, content in read_messages(whole)["/imu"]] == [row / 10 for row in range(ROWS)]


def test_they_are_checked(results: Any) -> None:
    hurt = results["findings"].pop("hurt")
    assert ["stretches of rows without a picture", "/camera/rear row 3"] in hurt
    assert ["rows out of order", "/imu row 7"] in hurt
    assert len(hurt) == 2
    assert not any(results["findings"].values())


def test_the_camera_is_indexed(folder: Path) -> None:
    frames = pq.read_table(folder / "index" / "frames" / "whole.parquet")
    rear = frames.filter(pc.equal(frames["camera"], "rear")).sort_by("row")
    assert rear["row"].to_pylist() == list(range(ROWS))
    samples = pq.read_table(folder / "index" / "samples.parquet")
    assert set(samples["camera"].to_pylist()) == {"rear"}
    straight = samples.filter(pc.invert(samples["flip"]))
    label = dict(zip(*(straight[name].to_pylist() for name in ("row", "label")), strict=True))
    assert label == {row: 0.01 * row for row in label}  # no camera but the side ones is corrected


def test_they_are_played(folder: Path, results: Any) -> None:
    entities = contents(folder / "whole.rrd")
    assert len(entities["/camera/rear"]["EncodedImage:blob"]) == ROWS
    assert [value for (value,) in entities["/mps2/lateral"]["Scalars:scalars"] if value is not None] == [
        row / 10 for row in range(ROWS)
    ]
    assert {"rear camera", "acceleration, m/s²"} <= view_names(folder / "whole.rrd")
    assert {"/camera/rear", "/imu"} <= set(results["shown while it grows"])
