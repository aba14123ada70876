"""A LeRobot dataset becomes a log: one of ours as it was, those of others with what their names tell."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from recorder import Imported, Log, LogError, LogWriter, RecordingError
from recorder.bc_pb2 import VehicleState
from recorder.import_cli import main as bc_import
from recorder.lerobot.export import export_lerobot
from recorder.log.meant_gaps import MeantGap
from recorder.log.session_car import Car, metadata_of, stored_car
from recorder.rows.row_quality import drive_numbers
from recorder.sources.import_recording import import_recording
from recorder.sources.settings import ImportSettings
from recorder.upkeep.check import check
from recorder.upkeep.log_info import describe
from tests.helpers.lerobot_folders import as_image, image_feature, numbers_feature, write_dataset
from tests.helpers.lerobot_logs import decoded, jpeg, write_drives
from tests.helpers.logs import START_NS, read_messages
from tests.helpers.udacity import call

FRONT = "observation.images.front"
LENGTHS = [3, 2]
STEERING = [-0.5, 0.0, 0.25, 0.5, 1.0]


def imported(folder: Path, *, overwrite: bool = False, **printed: Any) -> Imported:
    return import_recording(
        folder, folder.parent / "imported.mcap", ImportSettings(**printed), overwrite=overwrite
    )


def content(log: Path) -> dict[str, list[tuple[Any, ...]]]:
    """Time, row and content of every message on the cameras and the vehicle, by mcap's own reader."""
    by_topic: dict[str, list[tuple[Any, ...]]] = {}
    for topic, messages in read_messages(log).items():
        if topic == "/vehicle":
            by_topic[topic] = [
                (m.log_time, m.sequence, s.steering, s.throttle, s.brake, str(s.speed_mph)) for m, s in messages
            ]
        elif topic.startswith("/camera/"):
            by_topic[topic] = [(m.log_time, m.sequence, image.data) for m, image in messages]
    return by_topic


def others(folder: Path, **info: Any) -> Path:
    """Somebody's dataset: one camera, an action of three numbers whose names are under some key."""
    features = {
        FRONT: image_feature(),
        "action": numbers_feature({"axes": ["gas_pedal", "brake_pedal", "steering_angle"]}, 3),
        "observation.state": numbers_feature(["speed_mps"], 1),
    }
    columns: dict[str, Sequence[Any]] = {
        FRONT: [as_image(jpeg("center", row)) for row in range(5)],
        "action": [[0.5, 0.25, value] for value in STEERING],
        "observation.state": [4.4704] * 5,
    }
    return write_dataset(folder, features, columns, LENGTHS, **info)


@pytest.mark.parametrize("speed_mph", [9.3, math.nan])
def test_an_export_comes_back_as_it_was(tmp_path: Path, speed_mph: float) -> None:
    log = write_drives(tmp_path / "two.mcap", speed_mph=speed_mph)
    export_lerobot([log], tmp_path / "out")
    done = imported(tmp_path / "out")
    assert (done.rows, done.pictures, list(done.skipped), list(done.notices)) == (20, 60, [], [])
    assert content(done.path) == content(log)
    with Log(done.path) as opened:
        assert opened.metadata["source"] == "lerobot"
        assert opened.metadata["clock"] == "recorded"


@pytest.mark.parametrize("flags", [{}, {"steering": "action.steering"}])
def test_an_export_of_the_version_before_comes_back(tmp_path: Path, flags: dict[str, Any]) -> None:
    """Its state was one number, the speed."""
    log = write_drives(tmp_path / "two.mcap")
    export_lerobot([log], tmp_path / "out")
    now = content(imported(tmp_path / "out", **flags).path)
    (data,) = (tmp_path / "out/data").glob("*/*.parquet")
    table = pq.read_table(data)
    speed = pa.array([9.3] * len(table), pa.float32())
    pq.write_table(
        table.set_column(table.column_names.index("observation.state"), "observation.state", speed), data
    )
    info = json.loads((tmp_path / "out/meta/info.json").read_text())
    state = {"observation.state": numbers_feature(["speed_mph"], 1)}
    change_info(tmp_path / "out", features=info["features"] | state)
    before = content(imported(tmp_path / "out", overwrite=True, **flags).path)
    assert before == now
    assert flags or before == content(log)


def test_the_car_of_a_session_comes_back(tmp_path: Path) -> None:
    car = Car(max_steering_deg=30.0, wheelbase_m=2.5)
    log = write_drives(tmp_path / "two.mcap", metadata=metadata_of(car))
    export_lerobot([log], tmp_path / "out")
    with Log(imported(tmp_path / "out").path) as opened:
        assert stored_car(opened) == car
    other = write_drives(tmp_path / "other.mcap")
    with pytest.raises(LogError, match="at steering 1, wheels turn by 25 and 30 degrees"):
        export_lerobot([log, other], tmp_path / "both")


def test_gaps_that_were_meant_come_back_as_such_and_others_as_gaps(tmp_path: Path) -> None:
    gap = MeantGap(2.0, "the car was put back on its line")
    with LogWriter(tmp_path / "a.mcap", {"source": "test"}) as writer:
        for row, seconds in enumerate((0.0, 0.1, 2.2, 2.3, 6.0, 6.1)):
            time_ns = START_NS + round(seconds * 1e9)
            writer.picture("center", time_ns, row, jpeg("center", row))
            writer.vehicle(time_ns, row, VehicleState(steering=row / 10, speed_mph=9.0), gap if row == 2 else None)
    export_lerobot([writer.path], tmp_path / "out")
    logs = (writer.path, imported(tmp_path / "out").path)
    for log in logs:
        checked = check(log)
        assert (checked.meant_gaps, checked.findings) == (["before row 2"], [("gaps in time", "before row 4")])
        assert describe(log).meant_gaps == [2]
    assert [[(event.log_time, text.message) for event, text in read_messages(log)["/events"]] for log in logs] == [
        [(START_NS + 2_200_000_000, str(gap))]
    ] * 2
    # as earlier versions have exported it
    (episodes,) = (tmp_path / "out/meta/episodes").glob("*/*.parquet")
    for missing, meant in (("log_not_recorded_s", ["before row 2"]), ("log_not_recorded", [])):
        pq.write_table(pq.read_table(episodes).drop_columns([missing]), episodes)
        assert check(imported(tmp_path / "out", overwrite=True).path).meant_gaps == meant


def test_a_gap_in_which_a_human_drove_is_explained_in_what_comes_back(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.mcap", {"source": "drive"}) as writer:
        for row, seconds in enumerate((0.0, 0.1, 4.1, 4.2)):
            time_ns = START_NS + round(seconds * 1e9)
            writer.picture("center", time_ns, row, jpeg("center", row))
            writer.vehicle(time_ns, row, VehicleState(steering=row / 10, speed_mph=9.0))
            if row == 1:
                writer.event(time_ns + 1, "manual: a human drives")
            elif row == 2:
                writer.event(time_ns, "manual: the pilot drives again")
    export_lerobot([writer.path], tmp_path / "out")
    back = imported(tmp_path / "out").path
    assert check(back).meant_gaps == ["before row 2"]
    assert [event.message for _, event in read_messages(back)["/events"]] == [
        str(MeantGap(4.0, "manual: the pilot drives again"))
    ]


def test_an_export_as_videos_comes_back_with_other_pictures_and_says_so(tmp_path: Path) -> None:
    log = write_drives(tmp_path / "two.mcap")
    export_lerobot([log], tmp_path / "out", is_video=True)
    done = imported(tmp_path / "out")
    assert (done.rows, done.pictures, list(done.skipped)) == (20, 60, [])
    assert "not the camera's original pictures" in done.notices[0]
    by_topic, original = content(done.path), content(log)
    assert by_topic["/vehicle"] == original["/vehicle"]
    originals = [decoded(jpeg("center", row)) for row in range(20)]
    for row, (*place, picture) in enumerate(by_topic["/camera/center"]):
        assert place == list(original["/camera/center"][row][:2])
        errors = [np.abs(decoded(picture) - other).mean() for other in originals]
        assert errors[row] == min(errors) < 12


def test_of_others_names_show_what_is_what(tmp_path: Path) -> None:
    done = imported(others(tmp_path / "theirs"))
    assert "action.steering_angle" in done.notices[0]
    times_ns = [0, 50_000_000, 100_000_000, 10_100_000_000, 10_150_000_000]
    by_topic = content(done.path)
    assert by_topic["/camera/center"] == [(t, row, jpeg("center", row)) for row, t in enumerate(times_ns)]
    assert by_topic["/vehicle"] == [
        (t, row, STEERING[row], 0.5, 0.25, by_topic["/vehicle"][row][5]) for row, t in enumerate(times_ns)
    ]
    with Log(done.path) as log:
        vehicle = log.vehicle()
        assert drive_numbers(vehicle["log_time_ns"].to_numpy()).tolist() == [0, 0, 0, 1, 1]
        assert vehicle["speed_mph"].to_pylist() == pytest.approx([10.0] * 5)
        assert log.metadata["start"].startswith("1970")
        assert (log.metadata["steering_topic"], log.metadata["robot"]) == ("action.steering_angle", "a_car")
    checked = check(done.path)  # the time between episodes was made here: nothing is lost
    assert checked.meant_gaps == ["before row 3"]
    assert "gaps in time" not in {finding.kind for finding in checked.findings}


@pytest.mark.parametrize(
    "names", [["speed_mps.pos", "throttle.pos", "Steering.pos"], {"steering": 2, "throttle": 1, "speed_mps": 0}]
)
def test_names_as_lerobot_itself_gives_them(tmp_path: Path, names: object) -> None:
    features = {FRONT: image_feature(), "action": numbers_feature(names, 3)}
    columns: dict[str, Sequence[Any]] = {
        FRONT: [as_image(jpeg("center", row)) for row in range(5)],
        "action": [[4.4704, 0.5, value] for value in STEERING],
    }
    done = imported(write_dataset(tmp_path / "theirs", features, columns, LENGTHS))
    rows = content(done.path)["/vehicle"]
    assert [row[2:5] for row in rows] == [(value, 0.5, 0.0) for value in STEERING]
    assert [float(row[5]) for row in rows] == pytest.approx([10.0] * 5)
    assert "no number has a name of these: brake is 0" in done.notices


def test_flags_say_it_where_names_do_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    features = {
        "observation.images.a": image_feature(),
        "observation.images.b": image_feature(),
        "action": numbers_feature(None, 2),
    }
    columns: dict[str, Sequence[Any]] = {
        "observation.images.a": [as_image(jpeg("left", row)) for row in range(5)],
        "observation.images.b": [as_image(jpeg("right", row)) for row in range(5)],
        "action": [[0.0, 10 * value] for value in STEERING],
    }
    theirs = write_dataset(tmp_path / "theirs", features, columns, LENGTHS)
    sessions = ["--sessions", tmp_path / "sessions"]
    assert call(bc_import, theirs, "mine", *sessions) == 1
    assert "Give --image, one of observation.images.a, observation.images.b" in capsys.readouterr().err
    image = ["--image", "observation.images.b"]
    assert call(bc_import, theirs, "mine", *sessions, *image) == 1
    assert "Give --steering, one of action.0, action.1" in capsys.readouterr().err
    steering = ["--steering", "action.1", "--steering-scale", -0.1]
    assert call(bc_import, theirs, "mine", *sessions, *image, *steering) == 0
    by_topic = content(tmp_path / "sessions/mine.mcap")
    assert [row[2] for row in by_topic["/vehicle"]] == pytest.approx([-value for value in STEERING])
    assert [row[2] for row in by_topic["/camera/center"]] == [jpeg("right", row) for row in range(5)]
    assert call(bc_import, theirs, "mine", *image, *steering, "--rate", 20, "--force", *sessions) == 1
    assert "its frames have their times" in capsys.readouterr().err


def test_episodes_that_are_not_there_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    theirs = write_dataset(
        tmp_path / "theirs",
        {FRONT: image_feature(), "action": numbers_feature(["steering"], 1)},
        {FRONT: [as_image(jpeg("center", row)) for row in range(4)], "action": [0.0] * 4},
        [2, 0, 0, 2],
        total_episodes=6,
        total_frames=9,
    )
    assert call(bc_import, theirs, "gaps", "--sessions", tmp_path) == 3
    printed = capsys.readouterr()
    assert "episodes that are counted but missing: 2 (episodes 1 to 2, episodes 4 to 5)" in printed.err
    assert "frames that are counted but missing: 1 (5 of 9)" in printed.err
    assert "4 rows, 4 pictures" in printed.out


def test_frames_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    pictures = [as_image(jpeg("center", 0)), as_image(jpeg("center", 1)[:-99]), None, as_image(jpeg("center", 3))]
    theirs = write_dataset(
        tmp_path / "theirs",
        {FRONT: image_feature(), "action": numbers_feature(["steering"], 1)},
        {FRONT: pictures, "action": [0.5, 0.5, 0.5, math.nan]},
        [4],
    )
    done = imported(theirs)
    assert done.rows == 1
    assert dict(done.skipped.counts) == {
        "pictures that are not whole JPEG or PNG files": 1,
        "frames without a picture": 1,
        "frames whose steering is not a finite number": 1,
    }


def change_info(folder: Path, **changes: Any) -> None:
    path = folder / "meta/info.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def change_features(folder: Path, **features: Any) -> None:
    change_info(folder, features={FRONT: image_feature(), **features})


DATA = "data/chunk-000/file-000.parquet"
NOT_LEROBOTS = r"info.json: not as LeRobot writes it"
SPOILT: dict[str, tuple[Callable[[Path], object], str]] = {
    "version 2": (
        lambda folder: change_info(folder, codebase_version="v2.1"),
        r"format v2.1; expected v3.0. LeRobot converts it: `python -m lerobot",
    ),
    "not JSON": (lambda folder: (folder / "meta/info.json").write_text("{" * 2000), r"info.json: not JSON"),
    "without features": (lambda folder: change_info(folder, features=7), NOT_LEROBOTS),
    "infinite frames": (lambda folder: change_info(folder, total_frames=math.inf), NOT_LEROBOTS),
    "too many frames a second": (lambda folder: change_info(folder, fps=10**400), NOT_LEROBOTS),
    "cut off": (
        lambda folder: os.truncate(folder / DATA, (folder / DATA).stat().st_size - 500),
        r"file-000.parquet: cannot be read as parquet .* Download it again",
    ),
    "without data": (lambda folder: (folder / DATA).unlink(), r"data: no parquet file in it"),
    "steering of another shape": (
        lambda folder: change_features(
            folder, action={"dtype": "float32", "shape": [5, 2], "names": ["steering"]}
        ),
        r"which number is the steering\? Give --steering, one of none",
    ),
    "a shape that is not true": (
        lambda folder: change_features(folder, action=numbers_feature([*"abcdefg", "steering"], 8)),
        r"file-000.parquet: not of the shapes that meta/info.json promises",
    ),
    "a column that is not there": (
        lambda folder: change_features(folder, act=numbers_feature(["steering"], 1)),
        r"no column 'act', which meta/info.json promises",
    ),
    "no pictures": (
        lambda folder: change_info(folder, features={"action": numbers_feature(["steering"], 1)}),
        r"it has no colour pictures",
    ),
    "a link out of it": (
        lambda folder: (folder / DATA).symlink_to((folder / DATA).rename(folder.parent / "elsewhere.parquet")),
        r"a link out of the dataset is not followed",
    ),
}


@pytest.mark.parametrize(("spoil", "why"), SPOILT.values(), ids=SPOILT)
def test_what_cannot_be_read_is_one_line(tmp_path: Path, spoil: Callable[[Path], object], why: str) -> None:
    theirs = others(tmp_path / "theirs")
    spoil(theirs)
    with pytest.raises(RecordingError, match=why) as raised:
        imported(theirs)
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "imported.mcap").exists()


def test_videos_that_are_missing_or_none_are_one_line(tmp_path: Path) -> None:
    export_lerobot([write_drives(tmp_path / "two.mcap", cameras=["center"])], tmp_path / "out", is_video=True)
    video = tmp_path / "out/videos/observation.images.center/chunk-000/file-000.mp4"
    original = video.read_bytes()
    video.write_bytes(b"#EXTM3U\n#EXTINF:10,\nfile:///etc/passwd\n")
    with pytest.raises(RecordingError, match=r"file-000.mp4: the video cannot be decoded"):
        imported(tmp_path / "out")
    video.unlink()
    with pytest.raises(RecordingError, match=r"file-000.mp4: not there; download the dataset with its videos"):
        imported(tmp_path / "out")
    video.write_bytes(original)
    episodes = tmp_path / "out/meta/episodes/chunk-000/file-000.parquet"
    table = pq.read_table(episodes)
    start = "videos/observation.images.center/from_timestamp"
    never = pa.array([math.inf] * len(table))
    pq.write_table(table.set_column(table.column_names.index(start), start, never), episodes)
    with pytest.raises(RecordingError, match="meta/episodes does not have the places of videos"):
        imported(tmp_path / "out")
    change_info(tmp_path / "out", video_path="{video_key:>999999999999}")
    with pytest.raises(RecordingError, match="; expected "):
        imported(tmp_path / "out")
