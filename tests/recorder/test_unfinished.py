"""A recording that was never finished: killed, still growing, or met by a full disk."""

from __future__ import annotations

import errno
import math
import os
import random
import re
import signal
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from common import UserError
from common.car import CAMERAS, Camera
from common.locks import is_being_written
from recorder import Log, LogError, LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.sources.udacity_follow import watch_udacity
from recorder.upkeep.check import check
from recorder.upkeep.recover import recover, recovered_name
from simulator.protocol.client import (
    ServerCommand,
    SimulatorClient,
    SimulatorMessage,
    SimulatorTelemetry,
    WaitTimeoutError,
)
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import Process, road_jpeg
from tests.helpers.layouts import two_kinds
from tests.helpers.logs import START_NS, STEP_NS, write_log
from tests.helpers.plain_mcap import contents
from tests.helpers.udacity import make_recording, paths
from tests.helpers.waiting import wait_until

ROWS = 40


def picture(camera: Camera, row: int) -> bytes:
    """As varied as a JPEG, and another one each time."""
    return random.Random(f"{camera} {row}").randbytes(500)


def pictures_of(path: Path) -> set[tuple[str, int, bytes]]:
    with Log(path) as log:
        assert log.notice
        return {
            (frame["camera"], frame["row"], log.read(frame["offset"], frame["length"], frame["chunk"]))
            for frame in log.frames().to_pylist()
        }


# Growing


def test_a_log_is_read_while_it_grows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each look sees all chunks that were complete when the log was opened, and goes on seeing just these."""
    monkeypatch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", 4096)
    path = tmp_path / "drive.mcap"
    looks: list[tuple[Log, set[tuple[str, int, bytes]]]] = []
    with LogWriter(path, {"source": "test"}) as writer:
        for row in range(ROWS):
            for camera in CAMERAS:
                writer.picture(camera, START_NS + row * STEP_NS, row, picture(camera, row))
            writer._stream.flush()  # a live one does so twice a second
            if row % 10 == 9:
                pictures = pictures_of(writer.part)
                assert pictures <= {(camera, r, picture(camera, r)) for camera in CAMERAS for r in range(row + 1)}
                assert len(pictures) > 3 * (row - 5)
                looks.append((Log(writer.part), pictures))
    for log, pictures in looks:
        frames = log.frames().to_pylist()
        assert {
            (f["camera"], f["row"], log.read(f["offset"], f["length"], f["chunk"])) for f in frames
        } == pictures
        log.close()
    with Log(path) as finished:
        assert (finished.notice, finished.frames().num_rows) == ("", 3 * ROWS)


HOLDER = """
import sys, time
from pathlib import Path
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState

with LogWriter(Path(sys.argv[1]), {"source": "test"}, live=True) as writer:
    for row in range(5):
        writer.vehicle(1000 + row, row, VehicleState(steering=row / 5))
    while writer.bytes_written < 700:
        writer.flush_if_due()
        time.sleep(0.01)
    print("written", file=sys.stderr, flush=True)
    time.sleep(1000)
"""


def test_a_log_that_still_grows_is_reported_from_one_that_was_killed(tmp_path: Path) -> None:
    with Process([sys.executable, "-c", HOLDER, str(tmp_path / "lake.mcap")]) as recorder:
        recorder.wait_for("written")
        [part] = tmp_path.iterdir()
        assert is_being_written(part)
        with Log(part) as log:
            assert log.problem == "unfinished: its recording is still going on"
            assert log.notice.endswith(". The end of the recording makes a finished log of it")
        for name in (tmp_path / "lake.mcap", Path(os.path.relpath(tmp_path / "lake.mcap"))):
            with pytest.raises(LogError, match=r"lake\.mcap: the running recording will get this name"):
                recover(part, name)
        written = recover(part, recovered_name(part))
        assert (written.path, written.rows) == (tmp_path / "lake.recovered.mcap", 5)
        reported = "it is still being recorded; lake.recovered.mcap lacks its end"
        assert written.notices == [f"{part}: {reported}"]
        recorder.end(signal.SIGKILL)
    assert not is_being_written(part)
    with Log(part) as log:
        assert log.problem == "unfinished: its recording was killed, or it was cut off"
    assert recover(part, recovered_name(part)).path == tmp_path / "lake.mcap"


# Names


@pytest.mark.parametrize(
    ("name", "beside", "becomes"),
    [
        ("lake.mcap.0a1b2c.part", "", "lake.mcap"),
        ("lake.mcap.0a1b2c.part", "lake.mcap", "lake.recovered.mcap"),
        ("lake.mcap", "", "lake.recovered.mcap"),
        ("lake", "", "lake.recovered.mcap"),
        ("a.b.mcap.ffffff.part", "", "a.b.mcap"),
        ("lake.mcap.0A1B2C.part", "", "lake.mcap.0A1B2C.part.recovered.mcap"),
        ("lake.part", "", "lake.part.recovered.mcap"),
    ],
)
def test_a_log_that_was_being_written_is_recovered_under_its_name(
    tmp_path: Path, name: str, beside: str, becomes: str
) -> None:
    if beside:
        (tmp_path / beside).touch()
    assert recovered_name(tmp_path / name) == tmp_path / becomes


def test_an_import_killed_before_its_first_row_is_reported(tmp_path: Path) -> None:
    """Its pictures fill chunks early. Its vehicle states are small, and come last."""
    whole = two_kinds(write_log(tmp_path / "whole.mcap", [0.0] * ROWS, picture))
    path = tmp_path / "drive.mcap.0a1b2c.part"
    path.write_bytes(whole.read_bytes()[: contents(whole).chunks[0].end])
    written = recover(path, tmp_path / "drive.mcap")
    assert (written.rows, written.messages > 0) == (0, True)
    assert written.notices == [f"{path}: no complete row in it: the new log has no rows"]


# Kills

RECORDERS = """
import os, sys
from pathlib import Path
from recorder.sources.settings import ListenSettings
from recorder.sources.live_telemetry import listen_for_telemetry

children = []
for log in map(Path, sys.argv[1:]):
    child = os.fork()
    if not child:
        said = os.open(log.with_suffix(".txt"), os.O_WRONLY | os.O_CREAT)
        os.dup2(said, 2)
        listen_for_telemetry(log, ListenSettings(port=0))
        os._exit(1)
    children.append(child)
print("children", *children, file=sys.stderr, flush=True)
for child in children:
    os.waitpid(child, 0)
"""
MAX_ROWS = 200
TOLD_EVERY_S = 0.04
PROMISED_S = 1.0
MIN_PROMISED = 4


@dataclass
class Drive:
    """A simulator that tells numbered pictures to a recorder, and when each one was answered."""

    log: Path
    pid: int
    pictures: list[bytes]
    answered_s: list[float] = field(default_factory=list)
    is_killed: bool = False
    sent: int = 0

    @property
    def promised(self) -> int:
        """How many rows were answered so long before one was told that was written down. By the recorder's own
        work, not by the moment of its death: on a busy machine, it may not have run for seconds before that."""
        answered_s = list(self.answered_s)
        if len(answered_s) < 3:
            return 0
        return sum(at_s < answered_s[-3] - PROMISED_S for at_s in answered_s)

    def run(self) -> None:
        client = SimulatorClient(port=self._port(), wait_s=0.0)
        try:
            client.run(self._next)
        except WaitTimeoutError:  # it was killed
            assert client.connections == 1

    def _port(self) -> int:
        path = self.log.with_suffix(".txt")
        wait_until(path.exists)
        port = wait_until(lambda: re.search(r"127\.0\.0\.1:(\d+)\n", path.read_text()))
        assert port is not None
        return int(port[1])

    def _next(self, answer: ServerCommand) -> SimulatorMessage:
        if answer is not None:
            self.answered_s.append(time.monotonic())
            time.sleep(TOLD_EVERY_S)
        row = self.sent
        self.sent += 1
        if row == MAX_ROWS:
            return None
        return SimulatorTelemetry(steering=row / MAX_ROWS, throttle=0.5, speed_mph=9.0, jpeg=self.pictures[row])


def recorders_killed_at(moments_s: list[float], folder: Path, pictures: list[bytes]) -> list[Drive]:
    """Record as many drives at once, and kill each so long after something of it is promised."""
    logs = [folder / f"drive{number}.mcap" for number in range(len(moments_s))]
    with Process([sys.executable, "-c", RECORDERS, *map(str, logs)]) as parent:
        pids = parent.wait_for(r"^children ([\d ]+)$")[1].split()
        drives = [Drive(log, int(pid), pictures) for log, pid in zip(logs, pids, strict=True)]
        threads = [threading.Thread(target=drive.run) for drive in drives]
        try:
            for thread in threads:
                thread.start()
            due_s: dict[int, float] = {}

            def are_killed() -> bool:
                for number, drive in enumerate(drives):
                    if number not in due_s and drive.promised >= MIN_PROMISED:
                        due_s[number] = time.monotonic() + moments_s[number]
                    if not drive.is_killed and time.monotonic() >= due_s.get(number, math.inf):
                        os.kill(drive.pid, signal.SIGKILL)
                        drive.is_killed = True
                return all(drive.is_killed for drive in drives)

            wait_until(are_killed)
        finally:
            for drive in drives:
                if not drive.is_killed:
                    os.kill(drive.pid, signal.SIGKILL)
            for thread in threads:
                thread.join()
    return drives


@pytest.mark.parametrize("turns", [1, pytest.param(10, marks=pytest.mark.long)])
def test_recordings_killed_at_any_moment_lose_at_most_a_second(tmp_path: Path, turns: int) -> None:
    pictures = [road_jpeg(row) for row in range(MAX_ROWS)]
    chance = random.Random(7)
    complaints = []
    for turn in range(turns):
        folder = tmp_path / str(turn)
        folder.mkdir()
        moments_s = [chance.uniform(0.0, 1.3) for _ in range(5 if turns == 1 else 10)]
        for drive in recorders_killed_at(moments_s, folder, pictures):
            [part] = drive.log.parent.glob(f"{drive.log.name}.*.part")
            written = recover(part, recovered_name(part))
            assert written.path == drive.log
            content = contents(written.path)  # every CRC is checked
            images = [CompressedImage.FromString(m.data).data for m in content.of("/camera/center")]
            rows = [(m.sequence, VehicleState.FromString(m.data).steering) for m in content.of("/vehicle")]
            promised = drive.promised
            assert promised >= MIN_PROMISED
            is_whole = images == pictures[: len(rows)]
            is_whole &= rows == [(row, row / MAX_ROWS) for row in range(len(rows))]
            others = {finding.kind for finding in check(written.path).findings}
            is_whole &= others <= {"gaps in time"}  # this computer's clock goes on while others have the processor
            if len(rows) < promised or not is_whole:
                complaints.append(f"{drive.log}: {len(rows)} rows, {len(images)} pictures, {promised} promised")
    assert complaints == []


# A full disk


def test_wherever_the_disk_is_full_an_import_leaves_nothing(tmp_path: Path) -> None:
    """Also where only the end of the log does not fit any more."""
    size = write_log(tmp_path / "whole.mcap", [0.1] * 20, picture).stat().st_size
    folder = tmp_path / "disk"
    for limit in range(0, size, 1111):
        with files_of_at_most(limit), pytest.raises(UserError, match="nothing was kept"):
            write_log(folder / "lake.mcap", [0.1] * 20, picture)
        assert not folder.exists()
    with files_of_at_most(size):
        write_log(folder / "lake.mcap", [0.1] * 20, picture)


def test_a_live_log_whose_end_does_not_fit_is_kept(tmp_path: Path) -> None:
    def record(path: Path) -> None:
        with LogWriter(path, {}, live=True) as writer:
            writer.picture("center", 1, 0, bytes(9_000))

    record(tmp_path / "whole.mcap")
    path = tmp_path / "lake.mcap"
    limit = contents(tmp_path / "whole.mcap").chunks[0].end + 10
    with (
        files_of_at_most(limit),
        pytest.raises(UserError, match=r"lake\.mcap\.[0-9a-f]{6}\.part: cannot be written any further"),
    ):
        record(path)
    [part] = tmp_path.glob("lake*")
    assert [message.sequence for message in contents(recover(part, path).path).messages] == [0]


def test_a_write_that_fails_in_the_background_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The system reports a lost write to one flush only, and then forgets it."""
    flush, failures = os.fsync, [OSError(errno.EIO, "Input/output error")]

    def fails_once(descriptor: int) -> None:
        if threading.current_thread().name == "sync" and failures:
            raise failures.pop()
        flush(descriptor)

    monkeypatch.setattr(os, "fsync", fails_once)
    monkeypatch.setattr("recorder.log.writer.FLUSH_S", 0.0)
    writer = LogWriter(tmp_path / "lake.mcap", {}, live=True)
    writer.picture("center", 1, 0, bytes(9_000))
    wait_until(lambda: not failures)
    with pytest.raises(UserError, match=r"\.part: cannot be written any further \(Input/output error\)"):
        writer.close()
    assert not (tmp_path / "lake.mcap").exists()


def test_a_recording_that_was_followed_is_kept_and_named(tmp_path: Path) -> None:
    folder, log = tmp_path / "drive", tmp_path / "log.mcap"
    make_recording(folder, "".join(f"{paths(number)},0,1,0,9.5\n" for number in range(3)))
    with files_of_at_most(2_000), pytest.raises(UserError, match=r"bc-log recover .*\.part"):
        watch_udacity(folder, log, idle_s=0)
    assert len(list(tmp_path.glob("log.mcap.*.part"))) == 1


def test_a_log_without_a_message_is_not_advised_to_be_recovered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("recorder.log.writer.FLUSH_S", 0.0)
    writer = LogWriter(tmp_path / "run.mcap", {"source": "drive"}, live=True)
    with files_of_at_most(10), pytest.raises(UserError, match=r"run.mcap: cannot be written .*nothing was kept"):
        writer.flush_if_due()
    writer.__exit__(UserError)
    assert not list(tmp_path.iterdir())
