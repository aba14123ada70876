"""Pictures have chunks of their own, everything else has others, and numbers are read without a picture."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from mcap.records import Channel, Message

from common.car import CAMERAS
from dataset import IndexConfig, build_index
from recorder import Log, LogWriter
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.upkeep.log_info import describe
from tests.helpers.bytes_read import note_reads
from tests.helpers.logs import START_NS, STEP_NS, not_a_picture
from tests.helpers.plain_mcap import Contents, contents

PICTURES = {*(f"/camera/{camera}" for camera in CAMERAS), "/pilot/input"}
ROWS = 200


def drive(path: Path) -> Path:
    with LogWriter(path, {"source": "test"}) as writer:
        for row in range(ROWS):
            time_ns = START_NS + row * STEP_NS
            for camera in CAMERAS:
                writer.picture(camera, time_ns, row, not_a_picture(camera, row) * 20)
            writer.crop(time_ns, row, b"\x89PNG\r\n\x1a\n" + bytes([row]))
            writer.vehicle(time_ns, row, VehicleState(steering=row / 1000, throttle=0.5, speed_mph=9.0))
            writer.command(time_ns, row, PilotCommand(steering=row / 500))
            writer.pose(time_ns, row, PoseInFrame(frame_id="world"))
            if row % 10 == 0:
                writer.event(time_ns, f"at row {row}")
    return path


@pytest.fixture(autouse=True)
def _small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", 4096)


@pytest.fixture
def bytes_read(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[tuple[int, int]]]:
    read = note_reads(monkeypatch)
    yield read
    assert read


def picture_chunks(content: Contents) -> list[tuple[int, int]]:
    return [(chunk.start, chunk.end) for chunk in content.chunks if chunk.messages[0].topic in PICTURES]


class Interrupted:
    """Metadata of a channel: Ctrl-C comes when it is first looked at."""

    def __init__(self) -> None:
        self._is_over = False

    def keys(self) -> list[str]:
        if not self._is_over:
            self._is_over = True
            raise KeyboardInterrupt
        return []


def test_what_waits_to_be_written_is_not_lost_by_ctrl_c_while_it_is(tmp_path: Path) -> None:
    channel = Channel(1, "/mine", "json", Interrupted(), 0)  # type: ignore[arg-type]
    given: list[int] = []

    def record() -> None:
        with LogWriter(tmp_path / "a.mcap", {"source": "test"}, live=True) as writer:
            for row in range(ROWS):
                given.append(row)
                writer.vehicle(START_NS + row * STEP_NS, row, VehicleState(steering=row / 1000))
                if row == 5:
                    writer.copy(None, channel, Message(1, START_NS, b"{}", START_NS, 5), 5)

    with pytest.raises(KeyboardInterrupt):
        record()
    assert 20 < len(given) < ROWS
    assert [message.sequence for message in contents(tmp_path / "a.mcap").of("/vehicle")] == given


def test_numbers_are_read_without_a_picture(tmp_path: Path, bytes_read: list[tuple[int, int]]) -> None:
    path = drive(tmp_path / "a.mcap")
    pictures = picture_chunks(contents(path))
    bytes_read.clear()
    with Log(path) as log:
        assert len(log.vehicle()) == len(log.numbers("/pilot/command", ["steering"])) == ROWS
        assert len(log.frames()) == len(CAMERAS) * ROWS
        assert len(list(log.decoded("/events"))) == ROWS // 10
        assert log.counts["/camera/center"] == ROWS
        assert log.fingerprint == log.file_fingerprint
    assert describe(path).flags is not None
    build_index([path], tmp_path / "index", IndexConfig(block_s=1.0, gap_s=0.2))
    inside = [place for place in bytes_read if any(start < place[1] and place[0] < end for start, end in pictures)]
    assert inside == []


def test_a_picture_costs_its_own_chunk_and_no_other(tmp_path: Path, bytes_read: list[tuple[int, int]]) -> None:
    path = drive(tmp_path / "a.mcap")
    pictures = picture_chunks(contents(path))
    with Log(path) as log:
        log.frames()
        bytes_read.clear()
        log.picture(70, "left")
        log.picture(70, "right")
    touched = {
        (start, end) for start, end in pictures for place in bytes_read if start < place[1] and place[0] < end
    }
    assert 1 <= len(touched) <= 2
