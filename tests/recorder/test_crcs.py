"""Every chunk of our logs has a CRC: one of 0, MCAP's "there is none", is damage. Others' logs may do without."""

from __future__ import annotations

import json
import re
import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.writer import CompressionType
from mcap_protobuf.schema import register_schema

from common.car import CAMERAS
from dataset.cli import main as bc_index
from dataset.loader.crops import LogCrops
from drive.evaluation.eval_cli import main as bc_eval
from model.cli import main as bc_train
from recorder import Log, LogError, LogWriter
from recorder.bc_pb2 import PilotCommand, Prediction, VehicleState
from recorder.import_cli import main as bc_import
from recorder.log_cli import main as bc_log
from recorder.topics import ROW_TOPICS, VEHICLE
from recorder.upkeep.check import check, is_whole
from recorder.upkeep.edit import merge, split, trim, trim_times
from recorder.upkeep.recover import recover
from tests.helpers.driving import untrained_run
from tests.helpers.layouts import mixed
from tests.helpers.logs import START_NS, STEP_NS, write_log
from tests.helpers.other_logs import CAMERA, DRIVE, PICTURES, TOPICS, write_mcap
from tests.helpers.plain_mcap import by_topic, contents, plain_writer, write_plain
from tests.helpers.udacity import call, jpeg, picture
from viz.cli import main as bc_play

DATA_END = 0x0F
CRC_AT = 33  # within a chunk: opcode, length, two times, size, CRC
WITHOUT = "written without CRCs: damage to it cannot be noticed"


def without_crc(path: Path, number: int) -> Path:
    """A chunk's CRC becomes 0, and a bit in the middle of it is flipped."""
    chunk = contents(path).chunks[number]
    data = bytearray(path.read_bytes())
    data[chunk.start + CRC_AT : chunk.start + CRC_AT + 4] = bytes(4)
    data[(chunk.start + chunk.end) // 2] ^= 1
    path.write_bytes(data)
    return path


def place_of_chunk(path: Path, number: int) -> tuple[int, int]:
    with Log(path) as log:
        return log.chunks[number].start, log.chunks[number].end


def forty_rows(path: Path) -> Path:
    """Every kind of message, in two drives."""
    with LogWriter(path, {"source": "test"}) as writer:
        for row in range(40):
            time_ns = START_NS + row * STEP_NS + (row >= 20) * 5 * 10**9
            for camera in CAMERAS:
                writer.picture(camera, time_ns, row, picture(camera, row))
            writer.vehicle(time_ns, row, VehicleState(steering=row % 2 / 4, throttle=0.5, speed_mph=9.0))
            writer.command(time_ns, row, PilotCommand(steering=row / 50))
            writer.prediction("lake", time_ns, row, Prediction(steering=row / 50))
    return path


DAMAGED = {"mixed": 3, "pictures": 3, "rows": -1}
"""What is in the damaged chunk, and which one it is."""


@pytest.fixture(scope="module", params=DAMAGED)
def damaged(request: pytest.FixtureRequest) -> str:
    kind: str = request.param
    return kind


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, damaged: str) -> Path:
    """Forty rows in chunks of a few pictures, or of all rows."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", 20_000)
        path = forty_rows(tmp_path_factory.mktemp("whole") / "a.mcap")
        return mixed(path, 20_000) if damaged == "mixed" else path


@pytest.fixture(scope="module")
def forged(tmp_path_factory: pytest.TempPathFactory, whole: Path, damaged: str) -> Path:
    """The same; a chunk has no CRC, and a wrong bit. Tests only read it."""
    path = tmp_path_factory.mktemp("forged") / "a.mcap"
    shutil.copy(whole, path)
    return without_crc(path, DAMAGED[damaged])


def asked(path: Path, read: Callable[[Log], object]) -> None:
    with Log(path) as log:
        read(log)


def every_picture(log: Log) -> None:
    for row in range(40):
        for camera in CAMERAS:
            log.picture(row, camera)


def every_range(log: Log) -> None:
    for frame in log.frames().to_pylist():
        log.read(frame["offset"], frame["length"], frame["chunk"])


def every_message(log: Log) -> None:
    for topic in log.counts:
        for message in log.messages(topic):
            log.read(message.offset, message.length, message.chunk)


def every_crop(path: Path) -> tuple[set[int], set[str]]:
    """The rows of which there is a crop, and the names of the pictures that were left out."""
    with LogCrops(path) as crops:
        numbers = np.concatenate([numbers for numbers, _ in crops.batches(8)])
        return set(crops.row[numbers].tolist()), {name for _, name in crops.skipped}


Reader = Callable[[Path, Path], object]
READS_ALL: dict[str, Reader] = {
    "trim": lambda path, to: trim(path, to, (0, 39)),
    "trim by time": lambda path, to: trim_times(path, to, 0, 12),
    "merge": lambda path, to: merge([path, path], to),
    "split": split,
    "picture": lambda path, _: asked(path, every_picture),
    "read": lambda path, _: asked(path, every_range),
    "messages": lambda path, _: asked(path, every_message),
}
READS_ROWS: dict[str, Reader] = {
    "frames": lambda path, _: asked(path, Log.frames),
    "vehicle": lambda path, _: asked(path, Log.vehicle),
    "numbers": lambda path, _: asked(path, lambda log: log.numbers("/vehicle", ["steering"])),
    "vehicle_states": lambda path, _: asked(path, lambda log: list(log.vehicle_states())),
    "commands": lambda path, _: asked(path, lambda log: list(log.commands())),
    "predictions": lambda path, _: asked(path, lambda log: list(log.predictions("lake"))),
    "crops": lambda path, _: every_crop(path),
}


@pytest.mark.parametrize("reader", READS_ALL.values(), ids=READS_ALL)
def test_no_reader_believes_a_chunk_without_its_crc(forged: Path, tmp_path: Path, reader: Reader) -> None:
    with pytest.raises(LogError, match=r"a\.mcap: damaged: .*CRC.*bc-log recover"):
        reader(forged, tmp_path / "new.mcap")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("reader", READS_ROWS.values(), ids=READS_ROWS)
def test_whoever_wants_no_picture_reads_none(forged: Path, damaged: str, reader: Reader) -> None:
    """Where a picture is damaged, all else is given out if it has chunks of its own."""
    if damaged == "pictures":
        reader(forged, forged)
        return
    with pytest.raises(LogError, match=r"a\.mcap: damaged: .*CRC.*bc-log recover"):
        reader(forged, forged)


def test_the_commands_say_so(
    forged: Path,
    damaged: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An index is of places alone: whose picture is damaged is said by who reads it."""
    start, end = place_of_chunk(forged, DAMAGED[damaged])
    index = tmp_path / "index"
    if damaged == "pictures":
        assert call(bc_index, forged, "--index", index, "--gap-s", 0, "--block-s", 0.5) == 0
        capsys.readouterr()
        flags = ["--network", "small", "--epochs", 1, "--runs", tmp_path / "runs"]
        assert call(bc_train, *flags, "--index", index) == 3
        reported = (
            rf"pictures in damaged chunks of {re.escape(str(forged))} \(`bc-log recover \S+/a\.mcap` .*a row \d"
        )
        assert re.search(reported, capsys.readouterr().err)
        with monkeypatch.context() as in_folder:  # where a person types the log's name
            in_folder.chdir(forged.parent)
            assert call(bc_eval, untrained_run(tmp_path / "run"), "--session", forged) == 3
        assert re.search(r"of a\.mcap \(`bc-log recover a\.mcap` .*a row \d", capsys.readouterr().err)
    else:
        assert call(bc_index, forged, "--index", index) == 1
        assert "a.mcap: damaged" in capsys.readouterr().err
        assert not (index / "samples.parquet").exists()
        assert call(bc_play, forged, "--save", tmp_path / "a.rrd") == 1
        assert "a.mcap: damaged" in capsys.readouterr().err
        assert not (tmp_path / "a.rrd").exists()
    assert ("damaged chunks", f"bytes {start:,} to {end:,}") in check(forged).findings


def test_recovering_gives_it_no_new_crc(whole: Path, forged: Path, damaged: str, tmp_path: Path) -> None:
    start, end = place_of_chunk(forged, DAMAGED[damaged])
    written = recover(forged, tmp_path / "b.mcap")
    assert ("damaged chunks", f"bytes {start:,} to {end:,}") in list(written.skipped)
    recorded = contents(whole)
    hit = recorded.chunks[DAMAGED[damaged]].messages
    # nothing of a row whose state was in the hole
    lost = {message.sequence for message in hit if message.topic == VEHICLE} if damaged == "mixed" else set()
    kept = [m for m in recorded.messages if m not in hit and (m.sequence not in lost or m.topic not in ROW_TOPICS)]
    assert contents(written.path).by_topic == by_topic(kept)


def without_data_crc(path: Path) -> Path:
    data = bytearray(path.read_bytes())
    (summary_start,) = struct.unpack_from("<Q", data, len(data) - 28)
    assert data[summary_start - 13] == DATA_END
    assert any(data[summary_start - 4 : summary_start])
    data[summary_start - 4 : summary_start] = bytes(4)
    path.write_bytes(data)
    return path


def test_the_data_section_has_one_too(tmp_path: Path) -> None:
    path = without_data_crc(write_log(tmp_path / "a.mcap", [0.0, 0.25] * 20, picture))
    assert [kind for kind, _ in check(path).findings] == ["CRC of all data does not hold"]
    assert not is_whole(path)


def test_the_earliest_logs_of_ours_had_none_of_the_data_section(tmp_path: Path) -> None:
    """They have the version number of later ones, but no bc.quality, which came with that CRC."""
    path = tmp_path / "a.mcap"
    with plain_writer(
        path, profile="bc", library="behavioural-cloning-toolkit 0.1.0", compression=CompressionType.NONE
    ) as writer:
        writer.add_metadata("bc.session", {"source": "test", "toolkit": "0.1.0"})
        image = writer.register_channel("/camera/center", "protobuf", register_schema(writer, CompressedImage))
        state = writer.register_channel("/vehicle", "protobuf", register_schema(writer, VehicleState))
        for row in range(9):
            message = CompressedImage(data=picture("center", row), format="jpeg").SerializeToString()
            writer.add_message(image, row * 10**8, message, row * 10**8, row)
            data = VehicleState(steering=row / 10, throttle=0.5).SerializeToString()
            writer.add_message(state, row * 10**8, data, row * 10**8, row)
    assert check(path).findings == []
    assert is_whole(path)


# Other programs' logs


def test_of_another_program_s_log_it_is_said_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_mcap(tmp_path / "other.mcap", DRIVE, enable_crcs=False, compression=CompressionType.NONE)
    reported = f"{path}: {WITHOUT}\n"
    new = tmp_path / "new.mcap"
    lines: list[list[object]] = [
        ["check", path],
        ["trim", path, "--to", new, "--end", 1],
        ["merge", path, path, "--to", new],
        ["recover", path, "--to", new],
    ]
    for line in lines:
        new.unlink(missing_ok=True)
        assert call(bc_log, *line) == 0
        assert capsys.readouterr().err.count(reported) == 1 + (line[0] == "merge")
    assert call(bc_log, "check", path, "--json") == 0
    assert json.loads(capsys.readouterr().out)["has_crcs"] is False
    with_crcs = write_mcap(tmp_path / "with.mcap", DRIVE)
    assert call(bc_log, "check", with_crcs) == 0
    assert "without CRCs" not in capsys.readouterr().err


def without_crcs(path: Path) -> Path:
    """A log with our topics and messages that another program wrote."""
    return write_plain(path, CompressionType.NONE, range(11), picture=jpeg(60, 1), enable_crcs=False)


def test_who_shows_such_a_log_reports_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, other = without_crcs(tmp_path / "other.mcap"), without_crcs(tmp_path / "another.mcap")
    assert call(bc_play, path, "--save", tmp_path / "a.rrd") == 0
    assert capsys.readouterr().err.splitlines()[:-1] == [f"{path}: {WITHOUT}"]
    assert call(bc_play, path, other, "--save", tmp_path / "b.rrd") == 0
    assert capsys.readouterr().err.splitlines()[:-1] == [f"{path}: {WITHOUT}", f"{other}: {WITHOUT}"]
    ours = write_log(tmp_path / "ours.mcap", [0.1] * 5, picture)
    assert call(bc_play, ours, "--save", tmp_path / "c.rrd") == 0
    assert WITHOUT not in capsys.readouterr().err


def test_who_indexes_such_a_log_reports_so_as_long_as_it_is_in_the_index(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = without_crcs(tmp_path / "other.mcap")
    line = [path, "--index", tmp_path / "index", "--block-s", 0.5, "--gap-s", 0]
    for _ in range(2):  # the second time it is not read
        assert call(bc_index, *line) == 0
        assert capsys.readouterr().err.count(f"{path}: {WITHOUT}\n") == 1


def test_an_import_of_such_a_log_reports_so_and_its_log_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_mcap(tmp_path / "other.mcap", DRIVE, enable_crcs=False)
    line = [path, "mine", "--image", CAMERA, "--steering", TOPICS.steering, "--sessions", tmp_path / "sessions"]
    assert call(bc_import, *line) == 0
    assert capsys.readouterr().err.count("written without CRCs") == 1
    imported = contents(tmp_path / "sessions" / "mine.mcap")
    assert any(b"written without CRCs" in message.data for message in imported.of("/events"))
    assert len(imported.of("/camera/center")) == len(PICTURES)


def test_a_log_without_chunks_is_checked_too(tmp_path: Path) -> None:
    path = write_plain(tmp_path / "a.mcap", CompressionType.NONE, range(3), use_chunking=False)
    checked = check(path, look=False)
    assert (checked.messages, checked.findings, checked.has_crcs) == (6, [], False)
