"""A simulator sends PNG, and pictures of side cameras: they are in the log as they came, and train a network."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest

from common.car import CAMERAS, Camera
from dataset import IndexConfig, build_index
from recorder.upkeep.check import check
from simulator.protocol.client import ServerCommand, SimulatorClient, SimulatorMessage, SimulatorTelemetry
from tests.helpers.driving import PATIENCE_S, DriveProcess, Process, command, road_jpeg, untrained_run
from tests.helpers.logs import read_messages

ROWS, CUT_OFF = 30, 7
FIRST: dict[Camera, int] = {"center": 0, "left": 1000, "right": 2000}  # pictures differ


def sent(camera: Camera, row: int) -> bytes:
    """The centre camera's are PNG; one of the left camera is cut off."""
    jpeg = road_jpeg(FIRST[camera] + row)
    if camera == "center":
        picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        return cv2.imencode(".png", picture)[1].tobytes()
    return jpeg[:-300] if (camera, row) == ("left", CUT_OFF) else jpeg


def simulate(port: int) -> None:
    """A simulator in lock step, which disconnects behind its last row."""
    rows = iter(range(ROWS))

    def next_telemetry(answer: ServerCommand) -> SimulatorMessage:
        if answer is None and client.telemetries == 1:
            return "nothing"
        if (row := next(rows, None)) is None:
            return None
        sides: dict[Camera, bytes] = {camera: sent(camera, row) for camera in CAMERAS if camera != "center"}
        return SimulatorTelemetry(0.1, 0.2, 9.0, sent("center", row), {"time_s": row / 10}, sides)

    client = SimulatorClient(port=port, wait_s=PATIENCE_S)
    client.run(next_telemetry)


def driven(folder: Path) -> tuple[Path, int, list[str]]:
    run, log = untrained_run(folder / "run"), folder / "log.mcap"
    with DriveProcess(run, log) as process:
        simulate(process.wait_until_it_listens())
        process.wait_for("disconnected")
        return log, process.end(), process.stderr


def recorded(folder: Path) -> tuple[Path, int, list[str]]:
    arguments = ("listen", "log", "--port", 0, "--idle", 0.5, "--sessions", folder)
    with Process(command("bc-record", *arguments)) as process:
        simulate(int(process.wait_for(r"waiting for a simulator on 127\.0\.0\.1:(\d+)")[1]))
        return folder / "log.mcap", process.join(), process.stderr


@pytest.mark.parametrize("log_of", [driven, recorded])
def test_png_and_side_cameras_are_kept_as_they_came_and_trained_on(tmp_path: Path, log_of: object) -> None:
    assert callable(log_of)
    path, code, stderr = log_of(tmp_path)
    problem = "image_left is a JPEG that is cut off or damaged"
    assert code == 3
    assert any(line.endswith(f"a picture that cannot be used: {problem}") for line in stderr)
    messages = read_messages(path)
    for camera in CAMERAS:
        kept = {message.sequence: image for message, image in messages[f"/camera/{camera}"]}
        rows = [row for row in range(ROWS) if (camera, row) != ("left", CUT_OFF)]
        assert {row: image.data for row, image in kept.items()} == {row: sent(camera, row) for row in rows}
        assert {image.format for image in kept.values()} == {"png" if camera == "center" else "jpeg"}
    assert {(finding.kind, finding.where) for finding in check(path, look=False).findings} == {
        ("kinds of unusable telemetry", f"{problem} (1)"),
        ("stretches of rows without a picture", f"/camera/left row {CUT_OFF}"),
    }
    config = IndexConfig(balance=False, flip=False, block_s=0.5, gap_s=0.0, labels="as-recorded")
    samples = pq.read_table(build_index([path], tmp_path / "index", config).path / "samples.parquet").to_pylist()
    labels = {(sample["camera"], round(sample["label"], 6)) for sample in samples}
    assert labels == {("center", 0.1), ("left", 0.3), ("right", -0.1)}
