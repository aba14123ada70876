"""Two real recordings, published by other people: what is in the log is what they recorded, to the byte."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from dataset import build_index
from logs import plain_read, read_messages
from recorder import import_udacity
from recorder.topics import CAMERAS


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
