"""The page about the log format is enough to read a log, and it leaves nothing out."""

from __future__ import annotations

import hashlib
import math
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Chunk, DataEnd, Footer, Header
from mcap.stream_reader import StreamReader
from rosbags.rosbag2 import StoragePlugin

from common.car import CAMERAS, Camera
from model.evaluation.predict_log import predict_log
from recorder import Log, LogWriter, import_udacity
from recorder.bc_pb2 import PilotCommand, Prediction, VehicleState
from recorder.lerobot.export import export_lerobot
from recorder.log.meant_gaps import MeantGap
from recorder.log.tags import Tag, read_tags
from recorder.sources.built_in_simulator import record_simulated
from recorder.sources.import_recording import import_recording
from recorder.sources.record_gymnasium import GymRecording, record_gymnasium
from recorder.sources.settings import GymFlags, SimulatedDrive
from recorder.upkeep.edit import merge, rewrite, split, trim
from recorder.upkeep.recover import recover
from tests.helpers.driving import road_jpeg, run, run_code, untrained_run
from tests.helpers.imports import import_csv
from tests.helpers.logs import START_NS, STEP_NS, plain_read, read_messages
from tests.helpers.other_logs import DRIVE, ROS_TOPICS, TOPICS, write_bag, write_mcap
from tests.helpers.panorama import write_drive
from tests.helpers.repository import ROOT
from tests.helpers.tubs import record_1, record_2, write_tub_1, write_tub_2
from tests.helpers.udacity import jpeg as one_picture
from tests.helpers.udacity import make_recording, paths
from viz.playback.prediction_log import write_predictions

PAGE = (ROOT / "docs" / "log-format.md").read_text(encoding="utf-8")
ROOMS = sorted(path.parent.name for path in ROOT.glob("*/__init__.py"))

# steering, throttle, brake, speed; one row without a centre picture, more than one chunk of pictures
ROWS = [(math.sin(i) / 2, i / 40, (40 - i) / 80, math.nan if i == 7 else i * 0.75) for i in range(24)]
WITHOUT_CENTER = 5


def section(title: str) -> str:
    """A part of the page: from its heading to the next one that is not below it."""
    lines: list[str] = []
    level, in_code = 0, False
    for line in PAGE.splitlines(keepends=True):
        in_code ^= line.startswith("```")
        heading = re.match(r"(#+) (.*)", line) if not in_code else None
        if heading and level and len(heading[1]) <= level:
            break
        if level:
            lines.append(line)
        elif heading and heading[2] == title:
            level = len(heading[1])
    assert lines, f"no {title!r} on the page"
    return "".join(lines)


def blocks(title: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", section(title), re.DOTALL)


def named(title: str) -> set[str]:
    """What stands in code letters in a part of the page."""
    return set(re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", section(title), flags=re.DOTALL)))


def pictures_of(row: int) -> dict[Camera, bytes]:
    """Different for every row and camera: a JPEG may be followed by anything."""
    cameras = CAMERAS[1:] if row == WITHOUT_CENTER else CAMERAS
    return {camera: road_jpeg(row) + 500 * f"{camera} {row} ".encode() for camera in cameras}


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """`run.mcap` of ROWS, in a folder of its own."""
    path = tmp_path / "run.mcap"
    with LogWriter(path, {"source": "test"}) as writer:
        for row, (steering, throttle, brake, speed_mph) in enumerate(ROWS):
            time_ns = START_NS + row * STEP_NS
            for camera, jpeg in pictures_of(row).items():
                writer.picture(camera, time_ns, row, jpeg)
            state = VehicleState(steering=steering, throttle=throttle, brake=brake, speed_mph=speed_mph)
            writer.vehicle(time_ns, row, state)
    return path


def run_without_ours(code: str, folder: Path, *flags: str) -> subprocess.CompletedProcess[str]:
    """In a process in which importing any of the project's folders fails."""
    hidden = f"import sys; sys.modules.update(dict.fromkeys({ROOMS}))\n"
    return run_code(hidden + code, "-I", *flags, cwd=folder)


# The examples


def test_nothing_of_ours_can_be_imported_beside_the_first_example(tmp_path: Path) -> None:
    code = f"""
for room in {ROOMS}:
    try:
        __import__(room)
    except ModuleNotFoundError as error:
        print(error)
"""
    done = run_without_ours(code, tmp_path)
    assert done.stdout.splitlines() == [f"import of {room} halted; None in sys.modules" for room in ROOMS]


def test_the_example_with_mcap_reads_a_log_without_this_project(log: Path) -> None:
    code = (ROOT / "examples" / "log_with_mcap.py").read_text(encoding="utf-8")
    done = run_without_ours(code, log.parent)
    assert done.returncode == 0, done.stderr
    lengths = [len(pictures_of(row).get("center", b"")) for row in range(len(ROWS))]
    rows = zip(range(len(ROWS)), ROWS, lengths, strict=True)
    expected = [" ".join(map(str, (row, *values, length))) for row, values, length in rows]
    assert done.stdout.splitlines() == ["test 24 rows 23 pictures", *expected]


def test_the_example_with_the_toolkit(log: Path) -> None:
    code = (ROOT / "examples" / "log_with_toolkit.py").read_text(encoding="utf-8")
    done = run_code(code, cwd=log.parent)
    assert done.returncode == 0, done.stderr
    steering = [row[0] for row in ROWS]
    sharpest = min(steering)
    row = steering.index(sharpest)
    counts = {"/camera/center": 23, "/camera/left": 24, "/camera/right": 24, "/vehicle": 24}
    reported, *lines = done.stdout.splitlines()
    source, _, listed = reported.partition(" ")
    assert source == "test"
    assert sorted(re.findall(r"'(\S+)': (\d+)", listed)) == sorted((k, str(v)) for k, v in counts.items())
    assert lines == [
        f"24 rows, 71 pictures, mean steering {fmean(steering):+.4f}",
        f"sharpest left turn: row {row}, steering {sharpest:+.4f}, picture (160, 320, 3)",
        "71 samples",
    ]


@pytest.mark.parametrize("is_finished", [True, False], ids=["finished", "cut off"])
def test_the_example_without_any_library_finds_the_pictures(log: Path, is_finished: bool) -> None:
    data = log.read_bytes()
    end = len(data)
    if not is_finished:
        with log.open("rb") as stream:
            summary = make_reader(stream).get_summary()
        assert summary is not None
        last = summary.chunk_indexes[-2]  # of pictures; behind it come the rows
        end = last.chunk_start_offset
        log.write_bytes(data[: end + last.chunk_length // 2])
    expected = []
    for row in range(len(ROWS)):
        for camera, jpeg in pictures_of(row).items():
            offset = data.index(jpeg)
            if offset < end:
                expected.append(f"/camera/{camera} {row} {START_NS + row * STEP_NS} {offset} {len(jpeg)}")
    assert 30 < len(expected) < 71 or (is_finished and len(expected) == 71)
    code = (ROOT / "examples" / "log_without_library.py").read_text(encoding="utf-8")
    done = run_without_ours(code, log.parent, "-S")
    assert (done.stdout.splitlines(), done.stderr) == (expected, "")


def test_the_example_of_tags_is_what_the_toolkit_reads(log: Path) -> None:
    (lines,) = blocks("Tags", "json")
    digest = hashlib.sha256(len(log.read_bytes()).to_bytes(8, "little"))
    with log.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    for start in sorted(index.chunk_start_offset for index in summary.chunk_indexes):
        digest.update(plain_read(log, start, 37))
    (shown,) = set(re.findall(r'"log": "(\w+)"', lines))
    log.with_name("run.tags.jsonl").write_text(lines.replace(shown, digest.hexdigest()), encoding="utf-8")
    with Log(log) as opened:
        assert read_tags(log, opened.fingerprint) == [Tag(300, 310, "exclude")]
    assert read_tags(log, shown) == []


# Nothing is left out


@dataclass(frozen=True)
class Written:
    """A log as mcap's own reader sees it."""

    schemas: dict[str, str]  # by topic
    metadata: list[tuple[str, dict[str, str]]]
    events: list[str]
    path: Path


def read_back(path: Path) -> Written:
    with path.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        schemas = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
        metadata = [(record.name, dict(record.metadata)) for record in reader.iter_metadata()]
    events = [event.message for _, event in read_messages(path).get("/events", [])]
    return Written(schemas, metadata, events, path)


@pytest.fixture(scope="module")
def every_kind(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Written]:
    """A real log of each kind, as small as it may be."""
    folder = tmp_path_factory.mktemp("logs")
    path = {
        name: folder / f"{name}.mcap"
        for name in (
            "simulator",
            "udacity",
            "tub 1",
            "tub 2",
            "mcap",
            "bag",
            "csv",
            "lerobot",
            "gym",
            "recovered",
            "trimmed",
            "merged",
        )
    }
    record_simulated(SimulatedDrive(laps=0.002), path["simulator"])
    make_recording(folder / "recording", f"{paths(0)},0,0,0,1\n{paths(30)},0.5,1,0,1\n", [0, 7])
    import_udacity(folder / "recording", path["udacity"])
    untimed = {number: record_1(number) for number in range(2)}
    for record in untimed.values():
        del record["milliseconds"]
    import_recording(write_tub_1(folder / "tub 1", untimed, start_s=None), path["tub 1"])
    import_recording(write_tub_2(folder / "tub 2", map(record_2, range(4))), path["tub 2"])
    import_recording(write_mcap(folder / "other.mcap", DRIVE), path["mcap"], TOPICS)
    import_recording(write_bag(folder / "bag", StoragePlugin.MCAP), path["bag"], ROS_TOPICS)
    (folder / "pictures").mkdir()
    (folder / "pictures" / "0.jpg").write_bytes(one_picture(7))
    (folder / "pictures" / "log.csv").write_text("frame,angle\n0.jpg,0.5\n")
    import_csv(
        folder / "pictures", path["csv"], ["image=frame", "steering=angle"], rate=20.0, steering_offset=0.01
    )
    export_lerobot([path["udacity"]], folder / "dataset")
    import_recording(folder / "dataset", path["lerobot"])
    settings = (
        'id = "tests.helpers.toy_environment:toy/Bar-v0"\naction = "steering,throttle"\nargs.max_episode_steps = 3'
    )
    (folder / "bar.toml").write_text(settings)
    bar = GymFlags(str(folder / "bar.toml"), expert="tests.helpers.toy_environment:centre")
    record_gymnasium(GymRecording(bar), path["gym"])

    evaluated = run(
        "bc-eval",
        untrained_run(folder / "pilot", targets=("steering", "speed")),
        "--simulator",
        "lake",
        "--laps",
        0.002,
        "--drives",
        folder,
    )
    assert evaluated.returncode == 0, evaluated.stderr
    path["drive"] = folder / "pilot-lake-10mph.mcap"

    path["paused"] = folder / "paused.mcap"
    with LogWriter(path["paused"], {"source": "simulator"}) as writer:
        writer.vehicle(0, 0, VehicleState())
        writer.vehicle(2 * 10**9, 1, VehicleState(), MeantGap(2.0, "another episode begins"))

    path["two sizes"] = folder / "two sizes.mcap"
    with LogWriter(path["two sizes"], {"source": "udacity"}) as writer:
        for row, size in enumerate([(160, 320), (60, 80)]):
            writer.picture("center", row, row, cv2.imencode(".jpg", np.zeros(size, np.uint8))[1].tobytes())
            writer.vehicle(row, row, VehicleState())

    path["a minute"] = write_drive(folder / "a minute.mcap", [b"no picture"] * 601, source="udacity")
    recover(path["udacity"], path["recovered"])
    trim(path["simulator"], path["trimmed"], (1, 2))
    path["rewritten"] = rewrite(path["udacity"], folder / "rewritten.mcap").path
    merge([path["udacity"], path["drive"]], path["merged"])
    path["split"] = split(path["udacity"], folder)[1].path
    path["prediction"] = folder / "prediction.mcap"
    write_predictions(predict_log(path["simulator"], [folder / "pilot"]), path["prediction"])
    return {name: read_back(written) for name, written in path.items()}


def test_every_topic_stands_on_the_page_with_its_schema(every_kind: dict[str, Written]) -> None:
    reported = dict(re.findall(r"^\| `(/[a-zA-Z/]+)` \| `([\w.]+)` \|", section("Topics"), re.MULTILINE))
    schemas: dict[str, str] = {}
    for written in every_kind.values():
        schemas |= {
            re.sub("^/prediction/.+", "/prediction/NAME", topic): schema
            for topic, schema in written.schemas.items()
        }
    assert reported == schemas


def test_every_metadata_key_stands_on_the_page(every_kind: dict[str, Written]) -> None:
    reported = named("Metadata")
    missing, seen = set(), set()
    for kind, written in every_kind.items():
        for name, values in written.metadata:
            record = re.sub(r"^bc\.session of .*\.mcap$", "bc.session of NAME.mcap", name)
            keys = {record, *(re.sub(r"^weights_sha256\..+", "weights_sha256.NAME", key) for key in values)}
            seen |= keys
            missing |= {f"{kind}: {key}" for key in keys if key not in reported}
        source = dict(written.metadata)["bc.session"]["source"]
        assert source in reported, f"{kind}: source {source}"
    assert missing == set()
    # and no key on the page is one that no log has any more
    lines = re.findall(r"^\| (`.*?) \|", section("Metadata"), re.MULTILINE)
    assert {key for line in lines for key in re.findall(r"`([^`]+)`", line)} - seen == set()


def test_every_event_stands_on_the_page(every_kind: dict[str, Written]) -> None:
    reported = re.findall(r"^\| `(.+?)` \|", section("Events"), re.MULTILINE)
    patterns = [re.compile(re.sub(r"REASON|NAME|NUMBER|SIZE|SIDE", ".+", re.escape(text))) for text in reported]
    events = {event for written in every_kind.values() for event in written.events}
    assert events
    assert [event for event in events if not any(pattern.fullmatch(event) for pattern in patterns)] == []


@pytest.mark.parametrize("message", [VehicleState, PilotCommand, Prediction])
def test_every_field_stands_on_the_page(
    message: type[VehicleState] | type[PilotCommand] | type[Prediction],
) -> None:
    descriptor = message.DESCRIPTOR
    reported = re.findall(r"^\| `(\w+)` \|", section(descriptor.full_name), re.MULTILINE)
    assert reported == [field.name for field in descriptor.fields]
    values = {value.name for kind in descriptor.enum_types for value in kind.values}
    assert values - named(descriptor.full_name) == set()


def test_the_columns_in_the_example_are_those_of_the_tables(log: Path) -> None:
    code = (ROOT / "examples" / "log_with_toolkit.py").read_text(encoding="utf-8")
    reported = {name: columns.split(", ") for name, columns in re.findall(r"log\.(\w+)\(\)  # .*?: (.*)", code)}
    with Log(log) as opened:
        assert reported == {"frames": opened.frames().column_names, "vehicle": opened.vehicle().column_names}


def test_what_belongs_to_one_row_has_its_number_and_its_time(every_kind: dict[str, Written]) -> None:
    for kind, written in every_kind.items():
        messages = read_messages(written.path)
        rows = read_messages(every_kind["simulator" if kind == "prediction" else kind].path)["/vehicle"]
        times = {message.sequence: message.log_time for message, _ in rows}
        assert len(times) == len(rows), kind
        for topic, topic_messages in messages.items():
            for message, decoded in topic_messages:
                assert message.publish_time == message.log_time, (kind, topic)
                if topic == "/events":
                    assert message.sequence == 0, kind
                else:
                    assert times[message.sequence] == message.log_time, (kind, topic)
                if topic.startswith("/camera/") or topic == "/pilot/input":
                    assert decoded.timestamp.ToNanoseconds() == message.log_time
                    assert decoded.format == ("png" if topic == "/pilot/input" else "jpeg")
                    assert decoded.frame_id == f"tf#{topic}"


def test_the_file_is_laid_out_as_the_page_reports(every_kind: dict[str, Written]) -> None:
    for kind, written in every_kind.items():
        with written.path.open("rb") as stream:
            records = list(StreamReader(stream, emit_chunks=True).records)
        assert isinstance(records[0], Header)
        assert records[0].profile == "bc"
        chunks = [record for record in records if isinstance(record, Chunk)]
        assert chunks, kind
        assert all(chunk.compression == "" and chunk.uncompressed_crc for chunk in chunks), kind
        (data_end,) = (record for record in records if isinstance(record, DataEnd))
        (footer,) = (record for record in records if isinstance(record, Footer))
        assert data_end.data_section_crc, kind
        assert footer.summary_crc, kind
