"""What other programs read out of a log is what this toolkit reads, message by message, in both layouts.

The readers are mcap's own (with and without seeking), Foxglove's (`make foxglove-reader` brings it; it needs node)
and Rerun's.
"""

from __future__ import annotations

import dataclasses
import json
import os
import re
import subprocess
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pyarrow as pa
import pytest
from foxglove import layouts
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Log_pb2 import Log as LogMessage
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from mcap.reader import SeekingReader
from mcap.records import Channel, Message, Schema
from rerun.chunk import McapReader as RerunReader

from common.car import CAMERAS, Camera
from recorder import Log, LogWriter, topics
from recorder.bc_pb2 import PilotCommand, Prediction, VehicleState
from recorder.topics import camera_topic
from recorder.upkeep.edit import merge
from tests.helpers.driving import road_jpeg
from tests.helpers.layouts import is_of_pictures, write_as_before
from tests.helpers.needs import FOXGLOVE
from tests.helpers.plain_mcap import contents
from tests.helpers.repository import ROOT
from tests.helpers.waiting import PATIENCE_S, wait_until
from viz.viewer_process import viewer_program

START_NS, STEP_NS = 1_720_880_000_000_000_000, 40_000_000
ROWS, ROWS_A_PICTURE, ROWS_AN_EVENT = 300, 30, 20
CHUNK_BYTES = 50_000  # what is small fills more than one chunk, and so do the pictures


class Told(NamedTuple):
    """A message as a reader tells it; its content by its SHA-256."""

    sequence: int
    log_time: int
    publish_time: int
    content: str


@dataclass(frozen=True)
class Read:
    """All messages by topic, in the order of the reader, and what is known of each topic."""

    messages: dict[str, list[Told]]
    schemas: dict[str, tuple[str, str, str, str]]  # name, encoding, SHA-256; encoding of the messages


def digest(data: bytes) -> str:
    return sha256(data).hexdigest()


def gathered(stored: Iterable[tuple[Schema | None, Channel, Message]]) -> Read:
    messages: dict[str, list[Told]] = defaultdict(list)
    schemas = {}
    for schema, channel, message in stored:
        assert schema is not None
        reported = Told(message.sequence, message.log_time, message.publish_time, digest(message.data))
        messages[channel.topic].append(reported)
        schemas[channel.topic] = (schema.name, schema.encoding, digest(schema.data), channel.message_encoding)
    return Read(dict(messages), schemas)


def by_time(by_topic: dict[str, list[Told]]) -> dict[str, list[Told]]:
    return {
        topic: sorted(messages, key=lambda reported: reported.log_time) for topic, messages in by_topic.items()
    }


def backwards(by_topic: dict[str, list[Told]]) -> dict[str, list[Told]]:
    return {topic: messages[::-1] for topic, messages in by_time(by_topic).items()}


# The logs


def write_drive(path: Path, start_ns: int = START_NS, *, live: bool = False) -> Path:
    """12 s of driving with every topic that there is; a row in thirty has its pictures."""
    crop = cv2.imencode(".png", np.zeros((128, 128, 3), np.uint8))[1].tobytes()
    with LogWriter(path, {"source": "test"}, live=live) as writer:
        writer.event(start_ns - 1, "begin")
        for row in range(ROWS):
            time_ns = start_ns + row * STEP_NS
            if row % ROWS_A_PICTURE == 0:
                for camera in CAMERAS:
                    writer.picture(camera, time_ns, row, picture(camera, row))
                writer.crop(time_ns, row, crop + b"%d" % row)
            writer.vehicle(time_ns, row, VehicleState(steering=row / ROWS, throttle=0.5, speed_mph=9.0))
            writer.command(time_ns, row, PilotCommand(steering=row / ROWS, expert_steering=0.0))
            writer.pose(time_ns, row, PoseInFrame(frame_id="world"))
            writer.prediction("pilot", time_ns, row, Prediction(steering=-row / ROWS))
            if row % ROWS_AN_EVENT == 0:
                writer.event(time_ns + 1, f"at row {row}")
            if live and row in (ROWS // 3, ROWS // 2):
                wait_until(lambda: flushed(writer))
    return path


def picture(camera: Camera, row: int) -> bytes:
    return road_jpeg(row) + 700 * f"{camera} {row} ".encode()


def flushed(writer: LogWriter) -> bool:
    """True once a live log has closed its chunks, which it does twice a second."""
    written = writer.bytes_written
    writer.flush_if_due()
    return writer.bytes_written > written


LAYOUTS = ("two kinds of chunks", "mixed chunks, as before")
LOGS = ("a drive", "a live drive", "two drives, the later one first")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], Path]:
    """Each log in each layout."""
    folder = tmp_path_factory.mktemp("logs")
    first, live, two = (folder / f"{number}.mcap" for number in range(len(LOGS)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", CHUNK_BYTES)
        patch.setattr("recorder.mcap.split_chunks.ROWS_CHUNK_BYTES", CHUNK_BYTES // 8)
        write_drive(first)
        write_drive(live, live=True)
        merge([write_drive(folder / "later.mcap", START_NS + 10**12), first], two)
    logs: dict[tuple[str, str], Path] = {}
    for name, path in zip(LOGS, (first, live, two), strict=True):
        before = write_as_before(path, path.with_stem(f"{path.stem}-before"), CHUNK_BYTES)
        logs |= {(layout, name): log for layout, log in zip(LAYOUTS, (path, before), strict=True)}
    return logs


@pytest.fixture(params=LAYOUTS)
def layout(request: pytest.FixtureRequest) -> Any:
    return request.param


@pytest.fixture(params=LOGS)
def name(request: pytest.FixtureRequest) -> Any:
    return request.param


@pytest.fixture
def log(layout: str, name: str, written: dict[tuple[str, str], Path]) -> Path:
    return written[layout, name]


def ours(path: Path) -> Read:
    """What this toolkit reads, chunk by chunk."""
    with Log(path) as opened:
        return gathered(stored for chunk in opened.chunks for stored in opened.messages_of(chunk))


# mcap


def mcap_reads_the_same(read: Callable[[bool, bool], Read], expected: Read) -> None:
    """`read` is told whether to go by log times, and whether backwards."""
    assert read(False, False) == expected
    assert read(True, False) == Read(by_time(expected.messages), expected.schemas)
    assert read(True, True) == Read(backwards(expected.messages), expected.schemas)


def test_mcaps_own_reader_agrees(log: Path) -> None:
    def read(log_time_order: bool, reverse: bool) -> Read:
        with log.open("rb") as stream:
            reader = SeekingReader(stream, validate_crcs=True)
            return gathered(reader.iter_messages(log_time_order=log_time_order, reverse=reverse))

    mcap_reads_the_same(read, ours(log))


def test_mcaps_own_reader_agrees_on_a_topic_and_on_a_stretch(log: Path) -> None:
    expected = ours(log)
    with log.open("rb") as stream:
        reader = SeekingReader(stream, validate_crcs=True)
        for topic, messages in expected.messages.items():
            alone = gathered(reader.iter_messages([topic], log_time_order=False))
            assert alone.messages == {topic: messages}
        begin_ns, end_ns = START_NS + ROWS // 7 * STEP_NS, START_NS + ROWS // 2 * STEP_NS
        stretch = gathered(reader.iter_messages(starting_at=begin_ns, ending_before=end_ns))
        within = {
            topic: [reported for reported in messages if begin_ns <= reported.log_time < end_ns]
            for topic, messages in by_time(expected.messages).items()
        }
        assert stretch.messages == within


# Foxglove


def foxglove(path: Path, *topic: str) -> dict[str, Any]:
    line = ["node", str(FOXGLOVE / "read.mjs"), str(path), *topic]
    done = subprocess.run(line, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def in_topics(stored: list[tuple[str, int, str, str, str]]) -> dict[str, list[Told]]:
    messages: dict[str, list[Told]] = defaultdict(list)
    for topic, sequence, log_time, publish_time, content in stored:
        messages[topic].append(Told(sequence, int(log_time), int(publish_time), content))
    return dict(messages)


@pytest.mark.needs("foxglove")
def test_foxgloves_readers_agree(log: Path) -> None:
    expected = ours(log)
    answer = foxglove(log)
    assert in_topics(answer["streamed"]) == expected.messages
    assert in_topics(answer["indexed"]) == by_time(expected.messages)
    assert in_topics(answer["backwards"]) == backwards(expected.messages)
    assert {topic: tuple(schema) for topic, schema in answer["schemas"].items()} == expected.schemas
    with Log(log) as opened:
        assert answer["counts"] == opened.counts
        metadata = [[name, values] for name, values in opened.all_metadata]
    assert answer["metadata"] == answer["streamed_metadata"] == metadata
    attachments = [[name, digest(data)] for name, data in contents(log).attachments]
    assert answer["attachments"] == answer["streamed_attachments"] == attachments


@pytest.mark.needs("foxglove")
def test_foxglove_draws_a_curve_without_reading_pictures(written: dict[tuple[str, str], Path], name: str) -> None:
    path = written[LAYOUTS[0], name]
    answer = foxglove(path, "/vehicle")
    assert in_topics(answer["indexed"]) == {"/vehicle": by_time(ours(path).messages)["/vehicle"]}
    chunks = contents(path).chunks
    small = sum(chunk.end - chunk.start for chunk in chunks if not is_of_pictures(chunk.messages[0].topic))
    beside = path.stat().st_size - sum(chunk.end - chunk.start for chunk in chunks)  # indexes, summary
    assert answer["bytes"] <= small + beside


# Rerun


def rerun(*arguments: str | Path) -> str:
    line = [str(viewer_program()), "mcap", *map(str, arguments)]
    quiet = {**os.environ, "CI": "true"}  # else its first run on a machine prints a notice about usage data
    done = subprocess.run(line, env=quiet, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def rerun_rows(path: Path, decoders: list[str] | None = None) -> dict[str, list[dict[str, Any]]]:
    """By entity, each row: a dictionary of its columns; times in nanoseconds."""
    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for chunk in RerunReader(path, decoders=decoders).stream().to_chunks():
        if not chunk.is_static:
            batch = chunk.to_record_batch()
            columns = {
                name: (column.cast(pa.int64()) if pa.types.is_timestamp(column.type) else column).to_pylist()
                for name, column in zip(batch.schema.names, batch.columns, strict=True)
            }
            rows[str(chunk.entity_path)] += [
                dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)
            ]
    return dict(rows)


def test_reruns_reader_agrees(log: Path) -> None:
    """It tells no sequence numbers, and what it gives together is in the order of time."""
    by_topic = {
        topic: sorted(
            (row["message_log_time"], row["message_publish_time"], digest(bytes(row["McapMessage:data"][0])))
            for row in rows
        )
        for topic, rows in rerun_rows(log, ["raw"]).items()
    }
    expected = ours(log)
    assert by_topic == {
        topic: [reported[1:] for reported in messages] for topic, messages in by_time(expected.messages).items()
    }
    info = RerunReader(log).info()
    with Log(log) as opened:
        assert {channel.topic: channel.message_count for channel in info.channels} == opened.counts
        assert info.metadata_count == len(opened.metadata_records)
        assert info.attachment_count == len(contents(log).attachments)
        assert (info.message_start_time_ns, info.message_end_time_ns) == opened.time_range_ns
    for channel in info.channels:
        assert channel.schema is not None
        name, encoding, _, message_encoding = expected.schemas[channel.topic]
        assert (channel.schema.name, channel.schema.encoding) == (name, encoding)
        assert channel.message_encoding == message_encoding


def test_rerun_decodes_the_pictures_and_the_numbers(log: Path) -> None:
    rows = rerun_rows(log)

    def shown(topic: str, column: str) -> list[tuple[int, Any]]:
        return sorted((row["message_log_time"], row[column][0]) for row in rows[topic])

    with Log(log) as opened:
        for camera in CAMERAS:
            places = opened.pictures(f"/camera/{camera}")
            entries = zip(places.log_time_ns, places.offset, places.length, places.chunk, strict=True)
            jpegs = [
                (time_ns, list(opened.read(*place))) for time_ns, *place in (map(int, entry) for entry in entries)
            ]
            assert shown(f"/camera/{camera}", "EncodedImage:blob") == sorted(jpegs)
        for topic, message in (("/vehicle", "bc.VehicleState"), ("/pilot/command", "bc.PilotCommand")):
            steering = [(time_ns, state["steering"]) for time_ns, state in shown(topic, f"{message}:message")]
            assert steering == sorted(
                (reported.log_time_ns, state.steering) for reported, state in opened.decoded(topic)
            )


def test_rerun_finds_nothing_wrong(log: Path, name: str) -> None:
    """But that time goes back where a later drive was put before an earlier one."""
    reported, checked = rerun("info", log), rerun("check", "--full", log)
    with Log(log) as opened:
        for topic, count in opened.counts.items():
            (line,) = (line for line in reported.splitlines() if f" {topic} " in line)
            assert f" {count:,} " in line or f" {count} " in line
            (line,) = (line for line in checked.splitlines() if f" {topic} " in line)
            if name == LOGS[2]:
                assert re.search(r"^PROBLEM .* {2}\d+ unordered chunks on \w+, \d+ unordered chunks on \w+$", line)
            else:
                assert line.startswith("ok ")


LAYOUT = ROOT / "docs" / "foxglove-layout.json"
SCHEMAS: dict[str, Any] = {
    **{camera_topic(camera): CompressedImage.DESCRIPTOR for camera in CAMERAS},
    topics.PILOT_INPUT: CompressedImage.DESCRIPTOR,
    topics.VEHICLE: VehicleState.DESCRIPTOR,
    topics.PILOT_COMMAND: PilotCommand.DESCRIPTOR,
    topics.EVENTS: LogMessage.DESCRIPTOR,
    topics.POSE: PoseInFrame.DESCRIPTOR,
}
PANELS: dict[str, type] = {
    "Image": layouts.ImageConfig,
    "Plot": layouts.PlotConfig,
    "StateTransitions": layouts.StateTransitionsConfig,
    "RosOut": layouts.LogConfig,
}
TITLE = "foxglovePanelTitle"


@pytest.fixture(scope="module")
def foxglove_layout() -> dict[str, Any]:
    content: dict[str, Any] = json.loads(LAYOUT.read_text(encoding="utf-8"))
    return content


def texts(value: object) -> Iterator[str]:
    """Every text in it, however deep."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for inner in value.values():
            yield from texts(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from texts(inner)


def named(foxglove_layout: dict[str, Any]) -> set[str]:
    """The topics and message paths that its panels name."""
    return {text for text in texts(foxglove_layout["configById"]) if text.startswith("/")}


def settings_of(kind: type) -> set[str]:
    """The settings of a panel, or of a line of its, as its JSON calls them."""
    names = {field.name for field in dataclasses.fields(kind)}
    return {re.sub(r"_(\w)", lambda match: match[1].upper(), name) for name in names}


def test_every_message_path_leads_to_a_number_or_a_word_of_our_messages(foxglove_layout: dict[str, Any]) -> None:
    paths = named(foxglove_layout) - SCHEMAS.keys()
    assert len(paths) > 10
    for path in paths:
        topic, *names = path.split(".")
        message = SCHEMAS[topic]
        for name in names:
            assert name in message.fields_by_name, path
            message = message.fields_by_name[name].message_type
        assert message is None, path  # a message has fields, a number has none


def test_it_shows_every_topic_and_every_number_of_our_messages(foxglove_layout: dict[str, Any]) -> None:
    shown = named(foxglove_layout)
    assert {path.split(".")[0] for path in shown} == SCHEMAS.keys()
    for topic in (topics.VEHICLE, topics.PILOT_COMMAND):
        numbers = {field.name for field in SCHEMAS[topic].fields} - {"not_recorded_s"}  # a row of many has it
        assert {f"{topic}.{name}" for name in numbers} <= shown


def test_pictures_and_events_are_given_to_panels_that_show_them(foxglove_layout: dict[str, Any]) -> None:
    panels = foxglove_layout["configById"]
    pictures = {panel["imageMode"]["imageTopic"] for name, panel in panels.items() if name.startswith("Image!")}
    assert pictures == {topic for topic, schema in SCHEMAS.items() if schema is CompressedImage.DESCRIPTOR}
    logs = {panel["topicToRender"] for name, panel in panels.items() if name.startswith("RosOut!")}
    assert logs == {topic for topic, schema in SCHEMAS.items() if schema is LogMessage.DESCRIPTOR}


def test_panels_have_settings_that_foxgloves_sdk_knows(foxglove_layout: dict[str, Any]) -> None:
    for name, panel in foxglove_layout["configById"].items():
        kind = PANELS[name.split("!")[0]]
        assert panel.keys() - {TITLE} <= settings_of(kind), name
        assert panel.get("imageMode", {}).keys() <= settings_of(layouts.ImageModeConfig)
        line = layouts.StateTransitionsSeries if kind is layouts.StateTransitionsConfig else layouts.PlotSeries
        for path in panel.get("paths", []):
            assert path.keys() <= settings_of(line), name
            assert path["enabled"] is True  # one that is left out is not drawn
