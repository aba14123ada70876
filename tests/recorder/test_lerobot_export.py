"""`bc-log export --lerobot`: logs become a dataset that LeRobot reads, and nothing of them is changed."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import av
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from common.car import CAMERAS
from recorder import Log, LogError, LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.lerobot.dataset_files import DataFiles
from recorder.lerobot.export import Exported, export_lerobot
from recorder.log.tags import Tag, add_tags
from recorder.log_cli import main as bc_log
from tests.helpers.lerobot_logs import DRIVES, TIMES_NS, decoded, jpeg, steering, write_drives
from tests.helpers.logs import flip_bit
from tests.helpers.udacity import call

DATA = "data/chunk-000/file-000.parquet"
ROWS = range(len(TIMES_NS))


def info_of(folder: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((folder / "meta/info.json").read_text())
    return loaded


def exported_rows(folder: Path) -> list[int]:
    rows: list[int] = pq.read_table(folder / DATA)["log_row"].to_pylist()
    return rows


def lengths(folder: Path) -> list[int]:
    frames: list[int] = pq.read_table(folder / "meta/episodes")["length"].to_pylist()
    return frames


def test_every_frame_has_its_jpegs_steering_and_time_exactly(tmp_path: Path) -> None:
    log = write_drives(tmp_path / "two.mcap")
    done = export_lerobot([log], tmp_path / "out")
    assert (done.episodes, done.frames, done.pictures, list(done.skipped)) == (2, 20, 60, [])
    table = pq.read_table(tmp_path / "out" / DATA, page_checksum_verification=True)
    for camera in CAMERAS:
        images = table[f"observation.images.{camera}"].to_pylist()
        assert [image["bytes"] for image in images] == [jpeg(camera, row) for row in ROWS]
    frames = [row - drive.start for drive in DRIVES for row in drive]
    as_driven = [[steering(row), 0.1 * (row % 10), 0.0] for row in ROWS]
    assert table["frame_index"].to_pylist() == frames
    assert table["episode_index"].to_pylist() == [0] * 8 + [1] * 12
    assert table["index"].to_pylist() == list(ROWS)
    assert table["task_index"].to_pylist() == [0] * 20
    assert table["timestamp"].to_pylist() == [np.float32(frame / 10) for frame in frames]
    assert table["action"].to_pylist() == [np.array(values, np.float32).tolist() for values in as_driven]
    states = [[9.3, *([0.0] * 3 if row in (0, 8) else as_driven[row - 1])] for row in ROWS]  # 0, 8: a drive begins
    assert table["observation.state"].to_pylist() == [np.array(values, np.float32).tolist() for values in states]
    assert table["log_time_ns"].to_pylist() == TIMES_NS
    assert table["log_vehicle"].to_pylist() == [[*values, 9.3] for values in as_driven]
    with Log(log) as opened:
        assert set(table["log_fingerprint"].to_pylist()) == {opened.fingerprint}


def test_what_shows_of_it_is_as_lerobot_writes_it(tmp_path: Path) -> None:
    export_lerobot([write_drives(tmp_path / "two.mcap")], tmp_path / "out", task="Stay on the road.")
    info = info_of(tmp_path / "out")
    assert {name: info[name] for name in ("codebase_version", "fps", "chunks_size", "video_path", "splits")} == {
        "codebase_version": "v3.0",
        "fps": 10,
        "chunks_size": 1000,
        "video_path": None,
        "splits": {"train": "0:2"},
    }
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (2, 20, 1)
    assert info["features"]["observation.images.left"] == {
        "dtype": "image",
        "shape": [32, 64, 3],
        "names": ["height", "width", "channels"],
    }
    schema = pq.read_schema(tmp_path / "out" / DATA)
    assert schema.names == list(info["features"])
    assert [schema.field(name).type for name in ("timestamp", "frame_index", "action")] == [
        pa.float32(),
        pa.int64(),
        pa.list_(pa.float32(), 3),
    ]
    tasks = pd.read_parquet(tmp_path / "out/meta/tasks.parquet")
    assert tasks.index.tolist() == ["Stay on the road."]
    assert tasks["task_index"].tolist() == [0]
    episodes = pq.read_table(tmp_path / "out/meta/episodes/chunk-000/file-000.parquet").to_pylist()
    reported = ("episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index", "data/file_index")
    assert [tuple(episode[name] for name in reported) for episode in episodes] == [
        (0, ["Stay on the road."], 8, 0, 8, 0),
        (1, ["Stay on the road."], 12, 8, 20, 0),
    ]
    groups = pq.ParquetFile(tmp_path / "out" / DATA).metadata
    assert [groups.row_group(number).num_rows for number in range(groups.num_row_groups)] == [8, 12]


def test_excluded_rows_stay_out_and_what_they_leave_is_two_episodes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_drives(tmp_path / "long.mcap", times_ns=[TIMES_NS[0] + 100_000_000 * row for row in range(25)])
    with Log(log) as opened:
        add_tags(log, opened.fingerprint, [Tag(5, 16, "exclude")])
        add_tags(log, opened.fingerprint, [Tag(0, 24, "sunny")])
    assert call(bc_log, "export", log, "--lerobot", tmp_path / "out", "--license", "mit") == 0
    assert exported_rows(tmp_path / "out") == [*range(5), *range(17, 25)]
    assert lengths(tmp_path / "out") == [5, 8]
    printed = capsys.readouterr()
    assert "12 rows tagged exclude left out" in printed.err
    assert "2 episodes, 13 frames, 39 pictures" in printed.out
    assert "| 12 |" in (tmp_path / "out/README.md").read_text()


def test_rows_that_cannot_be_used_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "odd.mcap"
    with LogWriter(log, {"source": "test"}) as writer:
        for row in range(6):
            time_ns = TIMES_NS[row]
            size = (32, 32) if row == 3 else (64, 32)
            if row != 1:
                writer.picture("center", time_ns, row, jpeg("center", row, size)[: 300 if row == 4 else None])
            writer.vehicle(time_ns, row, VehicleState(steering=2.0 if row == 2 else 0.0, speed_mph=9.0))
    assert call(bc_log, "export", log, "--lerobot", tmp_path / "out") == 3
    assert exported_rows(tmp_path / "out") == [0, 5]
    printed = capsys.readouterr().err
    for line in (
        "skipped rows of odd.mcap without a picture of the center camera: 1 (row 1)",
        "skipped rows of odd.mcap with steering, pedals or speed out of range: 1 (row 2)",
        "skipped rows whose center picture is not 64 x 32 as the first: 1 (odd.mcap row 3)",
        "skipped rows with a picture that is not a whole JPEG or PNG: 1 (odd.mcap row 4)",
    ):
        assert line in printed


def test_of_a_damaged_log_what_is_whole_is_exported(tmp_path: Path) -> None:
    log = write_drives(tmp_path / "two.mcap")
    with Log(log) as opened:
        picture = opened.pictures("/camera/left")
    flip_bit(log, int(picture.offset[3]) + 50)
    # of so small a log, all pictures are in one chunk
    with pytest.raises(LogError, match=r"no row can be exported; pictures in damaged chunks .* recover"):
        export_lerobot([log], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_several_logs_are_one_dataset_of_the_cameras_that_all_have(tmp_path: Path) -> None:
    both = [
        write_drives(tmp_path / "a.mcap"),
        write_drives(tmp_path / "b.mcap", cameras=["center"], times_ns=[TIMES_NS[0] + 2 * t for t in range(0, 5)]),
    ]
    done = export_lerobot(both, tmp_path / "out")
    assert (done.episodes, done.frames, done.pictures) == (3, 25, 25)
    assert [name for name in info_of(tmp_path / "out")["features"] if "images" in name] == [
        "observation.images.center"
    ]
    assert done.notices[0] == (
        "the left camera is left out: only a.mcap has its pictures, and every frame of a dataset needs them"
    )
    assert pq.read_table(tmp_path / "out/meta/episodes")["log_name"].to_pylist() == ["a", "a", "b"]


def test_logs_without_a_camera_in_common_are_refused(tmp_path: Path) -> None:
    logs = [write_drives(tmp_path / f"{camera}.mcap", cameras=[camera]) for camera in ("left", "right")]
    with pytest.raises(LogError, match="they have no camera in common"):
        export_lerobot(logs, tmp_path / "out")
    LogWriter(tmp_path / "empty.mcap", {}).close()
    with pytest.raises(LogError, match=r"empty\.mcap: no camera's pictures$"):
        export_lerobot([tmp_path / "empty.mcap"], tmp_path / "out")
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".mcap"] * 3


def written(log: Path, steering_of_rows: Sequence[float], times_s: Sequence[float]) -> Path:
    with LogWriter(log, {"source": "test"}) as writer:
        for row, (steering_of_row, time_s) in enumerate(zip(steering_of_rows, times_s, strict=True)):
            time_ns = TIMES_NS[0] + round(time_s * 1e9)
            writer.picture("center", time_ns, row, jpeg("center", row))
            writer.vehicle(time_ns, row, VehicleState(steering=steering_of_row, throttle=0.5, speed_mph=9.0))
    return log


def state_steering(folder: Path) -> dict[int, float]:
    """The steering in the state of each row of the log."""
    table = pq.read_table(folder / DATA)
    at = info_of(folder)["features"]["observation.state"]["names"].index("previous_steering")
    return dict(
        zip(table["log_row"].to_pylist(), [row[at] for row in table["observation.state"].to_pylist()], strict=True)
    )


def test_a_state_is_of_the_row_before_and_0_where_a_drive_begins(tmp_path: Path) -> None:
    # row 3 is no steering, between 5 and 6 are 2 s, and at row 8 time goes back
    steering_of_rows = [0.125, 0.25, 0.375, 2.0, 0.5, 0.625, 0.75, 0.875, -0.125, -0.25]
    times_s = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 2.5, 2.6, 1.0, 1.1]
    log = written(tmp_path / "odd.mcap", steering_of_rows, times_s)
    with Log(log) as opened:
        add_tags(log, opened.fingerprint, [Tag(1, 1, "exclude")])
    export_lerobot([log], tmp_path / "out")
    assert state_steering(tmp_path / "out") == {
        0: 0.0,
        2: 0.25,  # of row 1, which is left out
        4: 0.375,
        5: 0.5,
        6: 0.0,
        7: 0.75,
        8: 0.0,
        9: -0.125,
    }


def test_an_unknown_speed_is_in_no_state(tmp_path: Path) -> None:
    log = write_drives(tmp_path / "no_speed.mcap", speed_mph=math.nan)
    export_lerobot([log], tmp_path / "out")
    state = info_of(tmp_path / "out")["features"]["observation.state"]
    assert (state["shape"], state["names"]) == ([3], ["previous_steering", "previous_throttle", "previous_brake"])
    assert "speed_mph" not in (tmp_path / "out/README.md").read_text()
    vehicle = pq.read_table(tmp_path / "out" / DATA)["log_vehicle"].to_pylist()
    assert all(math.isnan(speed_mph) for *_, speed_mph in vehicle)


def test_a_file_ends_before_it_is_larger_than_the_formats_size(tmp_path: Path) -> None:
    schema = pa.schema([("index", pa.int64())])
    files = DataFiles(tmp_path, schema, file_bytes=10_000)
    sizes = [4_000, 4_000, 4_000, 30_000, 100]
    numbers = []
    for at, size in enumerate(sizes):
        files.begin_episode(1, size)
        files.write({"index": pa.array([at])})
        numbers.append(files.number)
    files.close()
    assert numbers == [(0, 0), (0, 0), (0, 1), (0, 2), (0, 3)]
    indexes = [pq.read_table(path)["index"].to_pylist() for path in sorted(tmp_path.rglob("*.parquet"))]
    assert indexes == [[0, 1], [2], [3], [4]]


def test_nothing_that_exists_is_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_drives(tmp_path / "two.mcap")
    (tmp_path / "out").mkdir()
    assert call(bc_log, "export", log, "--lerobot", tmp_path / "out") == 1
    assert "exists already" in capsys.readouterr().err
    assert call(bc_log, "export", log, tmp_path / "missing.mcap", "--lerobot", tmp_path / "new") == 1
    assert {path.name for path in tmp_path.iterdir()} == {"two.mcap", "out"}
    assert call(bc_log, "export", log, "--lerobot", tmp_path / "new", "--task", " ") == 2


def test_an_export_that_is_interrupted_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = write_drives(tmp_path / "two.mcap")

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(pq.ParquetWriter, "write_table", interrupted)  # whenever Ctrl-C comes
    with pytest.raises(KeyboardInterrupt):
        export_lerobot([log], tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["two.mcap"]


def test_the_card_reports_what_who_how_and_asks_for_a_licence(tmp_path: Path) -> None:
    log = write_drives(tmp_path / "two.mcap", metadata={"driver": "ann|e <b>"})
    without: Exported = export_lerobot([log], tmp_path / "without")
    card = (without.folder / "README.md").read_text()
    assert "license:" not in card
    assert "ask whoever recorded it" in card
    assert "`observation.state`: `speed_mph`, miles an hour (1 is 0.44704 m/s), and `previous_steering`, " in card
    assert "They are 0 where a drive begins." in card
    assert "| two | source: test, driver: ann\\|e \\<b\\> | 20 | 2 | 0 |" in card
    assert (without.folder / "picture.jpg").read_bytes() == jpeg("center", 0)
    export_lerobot([log], tmp_path / "with", licence="cc-by-4.0")
    assert 'license: "cc-by-4.0"' in (tmp_path / "with/README.md").read_text().partition("\n---\n")[0]


def test_as_videos_each_frame_is_at_its_timestamp(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_drives(tmp_path / "two.mcap")
    assert call(bc_log, "export", log, "--lerobot", tmp_path / "out", "--video") == 0
    assert "the original pictures are not in the dataset" in capsys.readouterr().err
    info = info_of(tmp_path / "out")
    assert info["video_path"] == "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
    assert info["features"]["observation.images.center"]["dtype"] == "video"
    assert "observation.images.center" not in pq.read_schema(tmp_path / "out" / DATA).names
    key = "videos/observation.images.center"
    episodes = pq.read_table(tmp_path / "out/meta/episodes").to_pylist()
    spans = [(each[f"{key}/from_timestamp"], each[f"{key}/to_timestamp"]) for each in episodes]
    assert spans == [(0.0, 0.8), (0.8, 2.0)]
    with av.open(str(tmp_path / "out" / key / "chunk-000/file-000.mp4")) as video:
        frames = [(frame.time, frame.to_ndarray(format="bgr24")) for frame in video.decode(video=0)]
    assert [time for time, _ in frames] == pytest.approx([row / 10 for row in ROWS])
    for row, (_, frame) in enumerate(frames):
        original = decoded(jpeg("center", row))
        assert np.abs(frame.astype(int) - original).mean() < 12
