"""Two real recordings, published by other people: what is in the log is what they recorded, to the byte."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import torch

from common.car import CAMERAS
from dataset import IndexConfig, build_index, decode
from model import TrainConfig, load_pilot, train
from recorder import import_udacity
from simulator.protocol.client import SimulatorClient
from simulator.protocol.replay import replay
from tests.helpers.driving import DriveProcess
from tests.helpers.logs import plain_read, read_messages
from viz import save_rrd


@pytest.mark.parametrize(
    ("name", "rows", "pictures"), [("lake_windows", 1500, 4500), ("jungle_linux", 1167, 3501)]
)
def test_every_picture_and_value_of_a_real_recording(
    recordings: Path, tmp_path: Path, name: str, rows: int, pictures: int
) -> None:
    folder = recordings / name
    done = import_udacity(folder, tmp_path / f"{name}.mcap")
    assert (done.rows, done.pictures, len(done.skipped)) == (rows, pictures, 0)
    with (folder / "driving_log.csv").open(newline="") as stream:
        recorded = list(csv.reader(stream, skipinitialspace=True))
    assert len(recorded) == rows

    messages = read_messages(done.path)
    states = [state for _, state in messages["/vehicle"]]
    assert [(s.steering, s.throttle, s.brake, s.speed_mph) for s in states] == [
        tuple(map(float, row[3:7])) for row in recorded
    ]
    files = {}
    for column, camera in enumerate(CAMERAS):
        images = [image.data for _, image in messages[f"/camera/{camera}"]]
        names = [re.split(r"[/\\]", row[column])[-1] for row in recorded]
        assert len(images) == rows
        for row, (image, file) in enumerate(zip(images, names, strict=True)):
            files[camera, row] = (folder / "IMG" / file).read_bytes()
            assert image == files[camera, row], file

    build_index([done.path], tmp_path / "index")
    table = pq.read_table(tmp_path / "index" / "frames" / f"{name}.parquet").to_pylist()
    assert {(frame["camera"], frame["row"]) for frame in table} == files.keys()
    for frame in table:
        expected = files[frame["camera"], frame["row"]]
        assert plain_read(done.path, frame["offset"], frame["length"]) == expected
        assert frame["steering"] == float(recorded[frame["row"]][3])


@pytest.mark.parametrize("network", ["small", pytest.param("original", marks=pytest.mark.long)])
def test_the_whole_chain_on_a_real_recording(network: str, recordings: Path, tmp_path: Path) -> None:
    """Index, train, drive 300 of its pictures over the real wire, and play: nothing is lost on the way."""
    log = import_udacity(recordings / "jungle_linux", tmp_path / "jungle.mcap").path
    build_index([log], tmp_path / "index", IndexConfig(cameras=("center",), flip=False))
    run = tmp_path / "runs" / "real"
    [epoch] = train(tmp_path / "index", run, TrainConfig(epochs=1, network=network)).epochs
    assert epoch.training_loss > 0

    pictures = [path.read_bytes() for path in sorted((recordings / "jungle_linux" / "IMG").glob("center_*"))[:300]]
    with DriveProcess(run, tmp_path / "run.mcap") as drive:
        client = SimulatorClient(port=drive.wait_until_it_listens())
        commands = replay(client, pictures)
        assert drive.end() == 0
    assert (client.telemetries, len(commands), client.bad_steers) == (300, 300, 0)

    driven = read_messages(drive.log)
    assert [image.data for _, image in driven["/camera/center"]] == pictures
    torch.set_num_threads(1)  # as in the server
    pilot = load_pilot(run)
    for picture, (_, crop), (_, command) in zip(
        pictures, driven["/pilot/input"], driven["/pilot/command"], strict=True
    ):
        assert pilot.predict(pilot.crop(decode(picture))) == command.predicted_steering
        assert pilot.predict(decode(crop.data)) == command.predicted_steering

    save_rrd(drive.log, tmp_path / "run.rrd")
    assert (tmp_path / "run.rrd").stat().st_size > sum(map(len, pictures))
