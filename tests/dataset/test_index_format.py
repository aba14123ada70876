"""The page about the index's format is enough to read an index, and it leaves nothing out."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from common.car import Camera
from dataset import IndexConfig, build_index
from dataset.frames import frames_file
from dataset.frames.image_check_cache import check_all_images
from dataset.index.leaks import find_leaks
from dataset.parquet_file import read_metadata, write_table
from dataset.samples import samples_format
from dataset.samples.samples_writer import FROM_FRAMES
from recorder import Log, LogWriter
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.log.tags import Tag, add_tags
from recorder.rows.causes import PICTURE_FLAGS, ROW_FLAGS
from recorder.rows.condition import rows_where
from tests.helpers.driving import road_jpeg, run_code
from tests.helpers.logs import START_NS, STEP_NS, not_a_picture, write_log
from tests.helpers.repository import ROOT
from web.index.index_view import session_bins_sketch

PAGE = (ROOT / "docs" / "index-format.md").read_text(encoding="utf-8")
CAMERAS: tuple[Camera, ...] = ("center", "left", "right")


def section(title: str) -> str:
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]


def table_headed(text: str, head: str) -> list[list[str]]:
    """The cells of the table whose first column is headed so."""
    lines = text[text.index(f"| {head} |") :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


def in_code(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def first_column(text: str, head: str) -> list[str]:
    """What stands in code letters in the first column of a table."""
    return [name for cells in table_headed(text, head) for name in in_code(cells[0])]


def columns_of(text: str) -> list[tuple[list[str], str]]:
    """Names and type in each row of a table of columns."""
    return [(in_code(cells[0]), cells[1]) for cells in table_headed(text, "column")]


def picture(camera: Camera, row: int) -> bytes:
    """Different for every row and camera: a JPEG may be followed by anything."""
    return road_jpeg(row) + f"{camera} {row}".encode()


# steering, speed: unknown in the second half, at rest in the first rows
ROWS = [
    (round(math.sin(row / 3), 2) if row % 4 else 0.0, math.nan if row > 60 else 4.0 + row / 10)
    for row in range(120)
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `index` of the session `lake`: three cameras, tags, more than one block of time."""
    folder = tmp_path_factory.mktemp("format")
    log = folder / "lake.mcap"
    with LogWriter(log, {"source": "test"}) as writer:
        for row, (steering, speed_mph) in enumerate(ROWS):
            time_ns = START_NS + row * STEP_NS
            for camera in CAMERAS:
                writer.picture(camera, time_ns, row, picture(camera, row))
            writer.vehicle(time_ns, row, VehicleState(steering=steering, throttle=0.5, speed_mph=speed_mph))
            driver = PilotCommand.EXPERT if 30 <= row < 50 else PilotCommand.PILOT
            writer.command(time_ns, row, PilotCommand(steering=steering, driver=driver))
    with Log(log) as opened:
        fingerprint = opened.fingerprint
    add_tags(log, fingerprint, [Tag(10, 15, "recovery")])
    add_tags(log, fingerprint, [Tag(40, 70, "rain")])
    check_all_images({"lake": log}, folder / "index")
    build_index([log], folder / "index", IndexConfig(block_s=2.0, gap_s=0.3))
    return folder


def run_block(code: str, folder: Path, then: str) -> Any:
    """Run an example of the page in a process of its own; what it prints at its end, as JSON."""
    done = run_code(f"{code}\nimport json\nprint(json.dumps({then}))", cwd=folder)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


# The examples

BLOCKS = re.findall(r"```python\n(.*?)```", section("Reading it"), re.DOTALL)
AS_ROWS = {
    "duckdb": "found.fetchall()",
    "pandas": "[[split, int(row.frames), row.turned] for split, row in found.iterrows()]",
    "polars": "found.rows()",
}


@pytest.mark.parametrize(
    "library", [pytest.param("duckdb", marks=pytest.mark.needs("duckdb")), "pandas", "polars"]
)
def test_the_example_of_each_library_gives_the_answer(library: str, folder: Path) -> None:
    (code,) = (block for block in BLOCKS if f"import {library}" in block)
    assert len(code.splitlines()) == 3
    answer = run_block(code, folder, AS_ROWS[library])
    rows = pq.read_table(folder / "index" / "frames" / "lake.parquet").to_pylist()
    by_split = {
        split: [abs(ROWS[row["row"]][0]) for row in rows if row["split"] == split]
        for split in ("gap", "train", "validation")
    }
    assert [[split, frames] for split, frames, _ in answer] == [
        [split, len(steering)] for split, steering in by_split.items()
    ]
    assert [turned for *_, turned in answer] == pytest.approx([fmean(steering) for steering in by_split.values()])
    assert sum(frames for _, frames, _ in answer) == 3 * len(ROWS)


def test_the_example_for_a_picture_gives_its_bytes(folder: Path) -> None:
    (code,) = (block for block in BLOCKS if "jpeg = " in block)
    row, camera, data = run_block(code, folder, '[row["row"], row["camera"], jpeg.hex()]')
    assert bytes.fromhex(data) == picture(camera, row)


# The columns


@pytest.mark.parametrize(
    ("title", "schema"), [("Frames", frames_file.FRAMES_SCHEMA), ("Samples", samples_format.SAMPLES_SCHEMA)]
)
def test_every_column_stands_on_the_page_with_its_type(title: str, schema: pa.Schema) -> None:
    table = columns_of(section(title))
    assert [name for names, _ in table for name in names] == schema.names
    for names, kind in table:
        if kind:  # samples repeat some columns of the frames, which have their types there
            types = {
                re.sub(r"list<.*: string>", "list of strings", str(schema.field(name).type)) for name in names
            }
            assert types == {kind}
    assert {name for names, kind in table if not kind for name in names} <= set(FROM_FRAMES)


def test_every_flag_stands_on_the_page() -> None:
    assert sorted(first_column(section("Frames"), "flag")) == sorted([*ROW_FLAGS, *PICTURE_FLAGS])


def test_every_key_of_the_metadata_stands_on_the_page(folder: Path) -> None:
    for file, head in (("frames/lake", "key in frames"), ("samples", "key in samples")):
        stored = json.loads(pq.read_schema(folder / "index" / f"{file}.parquet").metadata[b"bc.index"])
        assert sorted(first_column(section("Metadata"), head)) == sorted(stored)
    assert stored["settings"].keys() == {field.name for field in dataclasses.fields(IndexConfig)}
    reported = set(re.findall(r"`([^`]+)`", section("Metadata")))
    assert reported >= stored["balance"].keys()
    assert reported >= stored["counts"]["lake"].keys()


def test_the_index_holds_the_files_on_the_page_and_no_others(folder: Path) -> None:
    reported = {name.replace("SESSION", "lake") for name in first_column(PAGE, "file")}
    index = folder / "index"
    assert {path.relative_to(folder).as_posix() for path in index.rglob("*") if path.is_file()} == reported


def test_the_samples_are_what_the_page_reports(folder: Path) -> None:
    of_frames = {
        (row["row"], row["camera"]): row
        for row in pq.read_table(folder / "index" / "frames" / "lake.parquet").to_pylist()
    }
    correction = {"center": 0.0, "left": 0.2, "right": -0.2}
    seen = set()
    for row in pq.read_table(folder / "index" / "samples.parquet").to_pylist():
        frame = of_frames[row["row"], row["camera"]]
        assert all(row[name] == frame[name] for name in FROM_FRAMES)
        assert row["split"] in ("train", "validation")
        label = min(1.0, max(-1.0, frame["steering"] + correction[row["camera"]])) * (-1 if row["flip"] else 1)
        assert row["label"] == pytest.approx(label, abs=1e-6)
        assert row["copy"] or (row["alteration"], row["seed"]) == ("", 0)
        seen |= {name for name in row["alteration"].split("+") if name}
    assert seen == {"blur", "brightness", "shadow"}
    straight = {row["bin"] for row in of_frames.values() if row["steering"] == 0}
    assert straight == {12}


# Choosing frames

CHOICES: dict[str, Callable[[dict[str, Any]], bool]] = {
    "speed_mph > 5 and abs(steering) < 0.9": lambda row: row["speed_mph"] > 5 and abs(row["steering"]) < 0.9,
    "speed_mph > 5 or speed_mph is null": lambda row: not row["speed_mph"] <= 5,  # NaN, too
    "'recovery' in tags or steering != 0": lambda row: "recovery" in row["tags"] or row["steering"] != 0,
    "'rain' not in tags and len(flags) = 0": lambda row: "rain" not in row["tags"] and not row["flags"],
    "'lake' in session and drive = 0": lambda row: True,
    "driver in ('expert', 'human')": lambda row: row["driver"] == "expert",
    "5 <= row <= 9": lambda row: 5 <= row["row"] <= 9,
    "row % 10 = 0": lambda row: row["row"] % 10 == 0,
    "camera = 'center' or min(steering + 1, 1 - steering) < 0.9": lambda row: (
        row["camera"] == "center" or abs(row["steering"]) > 0.1
    ),
}


@pytest.mark.parametrize("condition", CHOICES)
def test_a_condition_chooses_the_frames_that_the_page_reports(condition: str, folder: Path) -> None:
    table = frames_file.read_frames(folder / "index" / "frames" / "lake.parquet")
    chosen = rows_where(table, condition).tolist()
    assert chosen == [CHOICES[condition](row) for row in table.to_pylist()]
    assert any(chosen)


@pytest.mark.long
def test_an_index_is_read_whose_metadata_is_beyond_what_readers_take(tmp_path: Path) -> None:
    steering = 0.5 * np.sin(np.arange(400) / 9)
    log = write_log(tmp_path / "a.mcap", steering.tolist(), not_a_picture, cameras=["center"])
    indexed = build_index([log], tmp_path / "index")
    samples, sketch = indexed.samples, session_bins_sketch(indexed.path, "a")
    file = indexed.path / "samples.parquet"
    metadata = read_metadata(file)
    assert metadata is not None
    write_table(file, samples, metadata | {"more": "x" * (101 << 20)})
    with pytest.raises(OSError, match="size limit"):
        pq.read_table(file)
    assert replace(indexed).samples.equals(samples)
    assert find_leaks(indexed.path) == []
    assert session_bins_sketch(indexed.path, "a") == sketch
