"""A log shown while it is written: nothing is missed, nothing is shown before it is whole, and the recording does
not notice.

What a viewer gets is read back from an .rrd file by Rerun's own reader; what is in a log, by mcap's own.
"""

from __future__ import annotations

import itertools
import random
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil  # type: ignore[import-untyped]  # comes with rerun-sdk
import pytest
import rerun as rr

from common.car import CAMERAS
from recorder import LogError, LogWriter
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.topics import PICTURE_TOPICS
from tests.helpers.driving import Process, command, environment
from tests.helpers.logs import START_NS, STEP_NS, read_messages
from tests.helpers.ports import free_ports
from tests.helpers.rrd import arrived, contents, listening, view_names
from tests.helpers.udacity import call
from tests.helpers.waiting import PATIENCE_S, wait_until
from viz import save_growing, save_rrd
from viz.cli import main
from viz.live.follow import LogFeed
from viz.live.live_log import GrowingLog, LiveMessage, find_log
from viz.viewer_process import viewer_program

ROWS = 8

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="an open file cannot be renamed there")


PICTURE_BYTES = 66_000


def picture(row: int, side: int) -> bytes:
    """So large that a row fills a chunk, which then goes to the file at once, whatever the time."""
    return random.Random(4 * row + side).randbytes(PICTURE_BYTES)


def write_row(log: LogWriter, row: int) -> None:
    time_ns = START_NS + row * STEP_NS
    log.vehicle(time_ns, row, VehicleState(steering=row / 100, throttle=0.5, brake=0.25, speed_mph=row))
    log.command(time_ns, row, PilotCommand(predicted_steering=-row / 50, set_speed_mph=10, total_ms=row))
    if row % 5 == 0:
        log.event(time_ns, f"row {row}", "WARNING" if row else "INFO")
    for side, camera in enumerate(CAMERAS):
        log.picture(camera, time_ns, row, picture(row, side))
    log.crop(time_ns, row, picture(row, 3))


def write_rows(path: Path, rows: int = ROWS) -> Path:
    with LogWriter(path, {"source": "test"}) as log:
        for row in range(rows):
            write_row(log, row)
    return path


def in_the_log(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Times and contents by topic, from mcap's own reader."""
    return {
        topic: [(message.log_time, content.SerializeToString()) for message, content in of_topic]
        for topic, of_topic in read_messages(path).items()
    }


def shown_of(parts: Iterator[list[LiveMessage]]) -> dict[str, list[tuple[int, Any]]]:
    by_topic: dict[str, list[tuple[int, Any]]] = {}
    for message in (message for part in parts for message in part):
        content = message.content.SerializeToString()
        by_topic.setdefault(message.topic, []).append((message.log_time_ns, content))
    return by_topic


# Reading a log that grows


@pytest.mark.parametrize("seed", range(2))
def test_however_a_log_grows_all_of_it_is_shown_once(tmp_path: Path, seed: int) -> None:
    """The file ends anywhere, also within a chunk, and what is not whole yet is not shown."""
    whole = write_rows(tmp_path / "whole.mcap")
    data, chance = whole.read_bytes(), random.Random(seed)
    cuts = [0, *sorted(chance.sample(range(len(data) * 9 // 10), 30)), len(data)]
    path, counts = tmp_path / "grows.mcap", []
    path.touch()

    def parts() -> Iterator[list[LiveMessage]]:
        with GrowingLog(path) as log:
            for start, end in itertools.pairwise(cuts):
                with path.open("ab") as stream:
                    stream.write(data[start:end])
                assert not log.is_finished
                new = list(log.read())
                counts.append(sum(map(len, new)))
                yield from new
            assert log.is_finished
            assert len(log.skipped) == 0

    assert shown_of(parts()) == in_the_log(whole)
    assert sum(count > 0 for count in counts) > 5
    assert 0 in counts


def test_what_is_written_is_shown_before_the_log_is_finished(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "live.mcap", {}, live=True)
    with GrowingLog(writer.part) as log:
        assert shown_of(log.read()) == {}
        for row in range(3):
            write_row(writer, row)
            now = shown_of(log.read())
            assert (START_NS + row * STEP_NS) in [time_ns for time_ns, _ in now["/camera/center"]]
        assert not log.is_finished
        writer.close()
        shown_of(log.read())  # the file has another name now
        assert log.is_finished


def test_who_is_behind_skips_old_pictures_and_nothing_else(tmp_path: Path) -> None:
    path = write_rows(tmp_path / "a.mcap")
    with GrowingLog(path) as log:
        shown = shown_of(log.read(pictures_of_last_s=0.3))
    expected = in_the_log(path)
    for topic in ("/camera/center", "/camera/left", "/camera/right", "/pilot/input"):
        assert shown.pop(topic) == expected.pop(topic)[-4:]
    assert shown == expected
    ((reason, count),) = log.skipped.counts.items()
    assert "pictures not shown" in reason
    assert count == 4 * (ROWS - 4)
    assert ("/camera/left row 2") in [name for _, name in log.skipped]


def test_a_damaged_chunk_is_named_and_the_rest_is_shown(tmp_path: Path) -> None:
    path = write_rows(tmp_path / "a.mcap")
    expected = in_the_log(path)
    data = bytearray(path.read_bytes())
    data[data.index(picture(5, 1)) + 1000] ^= 1
    path.write_bytes(data)
    with GrowingLog(path) as log:
        shown = shown_of(log.read())
        assert log.is_finished
    ((reason, where),) = log.skipped
    assert "bytes" in reason
    start, end = (int(number.replace(",", "")) for number in where.split(" to "))
    assert start < data.index(picture(5, 2)) < end
    lost_ns = START_NS + 5 * STEP_NS
    for topic, messages in expected.items():
        is_whole = topic not in PICTURE_TOPICS
        assert shown[topic] == [message for message in messages if is_whole or message[0] != lost_ns]


def test_a_log_that_is_given_up_is_an_error_and_not_waited_for(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "a.mcap", {}, live=True)
    for row in range(2):
        write_row(writer, row)
    with GrowingLog(writer.part) as log:
        shown_of(log.read())
        writer.discard()
        with pytest.raises(LogError, match=r"a\.mcap: nothing more to show: the log was deleted"):
            shown_of(log.read())


def test_a_log_is_found_under_the_name_that_it_has_now(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    (tmp_path / "a.mcap.part").touch()
    (tmp_path / "xa.mcap.ab12cd.part").touch()
    (tmp_path / "a.mcap.ab12cd.part").symlink_to(tmp_path / "xa.mcap.ab12cd.part")
    writer = LogWriter(path, {})
    assert find_log(path) == find_log(writer.part) == writer.part
    writer.close()
    assert find_log(path) == find_log(writer.part) == path
    assert find_log(tmp_path / "b.mcap") == tmp_path / "b.mcap"
    assert find_log(tmp_path / "no" / "b.mcap") == tmp_path / "no" / "b.mcap"


def test_a_recording_that_waits_is_not_taken_for_a_killed_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("viz.live.live_log.QUIET_S", 0.0)
    monkeypatch.setattr("recorder.log.writer.FLUSH_S", 0.0)
    with LogWriter(tmp_path / "a.mcap", {}, live=True) as writer, GrowingLog(writer.part) as log:
        for row in range(2):
            assert [list(log.read()) for _ in range(3)][1:] == [[], []]
            write_row(writer, row)
        shown_of(log.read())
        assert log.notice == ""
        part = tmp_path / "b.mcap.ab12cd.part"
        part.write_bytes(writer.part.read_bytes())  # the same, but nobody writes it
        with GrowingLog(part) as left:
            topics = {*PICTURE_TOPICS, "/vehicle", "/pilot/command", "/events"}
            assert shown_of(left.read()).keys() == topics
            shown_of(left.read())
            assert "killed" in left.notice


# Showing it


def test_the_viewer_gets_what_it_would_get_of_the_finished_log(tmp_path: Path) -> None:
    rrd = tmp_path / "live.rrd"
    writer = LogWriter(tmp_path / "live.mcap", {}, live=True)
    line = [sys.executable, "-P", "-m", "viz.cli", str(writer.part), "--follow", "--save", str(rrd)]
    with Process(line) as play:
        for row in range(ROWS):
            write_row(writer, row)
            if row == ROWS // 2:
                wait_for_bytes(tmp_path, "live.rrd.*.part", row * 4 * PICTURE_BYTES)
        for row in range(ROWS, ROWS + 3):  # several in a chunk, and no pictures
            writer.vehicle(START_NS + row * STEP_NS, row, VehicleState(steering=row / 100))
        assert play.popen.poll() is None
        writer.close()
        assert play.join() == 0, play.stderr
    (step,) = play.stderr
    assert step.endswith(f"rerun {rrd}`")
    assert f"{rrd}: written" in play.stdout
    save_rrd(tmp_path / "live.mcap", tmp_path / "finished.rrd")
    entities, expected = contents(rrd), contents(tmp_path / "finished.rrd")
    shown = {entity for entity in expected if not entity.startswith("/__")}
    assert {entity for entity in entities if not entity.startswith("/__")} == shown
    lines, arcs, pictures = 12, 3, 4
    assert len(shown) == lines + arcs + pictures + len(("who drives", "histogram", "events"))
    for entity in shown:
        for column in entities[entity].keys() - {"rerun.controls.RowId"}:
            assert entities[entity][column] == expected[entity][column], (entity, column)
    assert len(entities["/steering/recorded"]["Scalars:scalars"]) == ROWS + 3
    assert (
        len(entities["/camera/right"]["EncodedImage:blob"])
        == len(entities["/pilot/input"]["EncodedImage:blob"])
        == ROWS
    )
    assert entities["/__properties"]["RecordingInfo:name"] == [["live.mcap"]]
    assert view_names(rrd) == view_names(tmp_path / "finished.rrd")


class RowByRow(threading.Event):
    """Whoever waits for it gets a row of the log instead of a while later, and in the end the end."""

    def __init__(self, writer: LogWriter) -> None:
        super().__init__()
        self.rows = 0
        self._writer = writer

    def wait(self, timeout: float | None = None) -> bool:
        if self.rows < ROWS:
            write_row(self._writer, self.rows)
            self.rows += 1
        else:
            self._writer.close()
        return False


class LateCommand(RowByRow):
    """The same, but only the last row has a command."""

    def wait(self, timeout: float | None = None) -> bool:
        time_ns = START_NS + self.rows * STEP_NS
        if self.rows == ROWS:
            self._writer.command(time_ns, self.rows, PilotCommand())
        self._writer.vehicle(time_ns, self.rows, VehicleState())
        self._writer.flush_if_due()
        self.rows += 1
        if self.rows > ROWS + 1:
            self._writer.close()
        return False


def test_a_file_has_one_layout_also_for_late_topics(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recorder.log.writer.FLUSH_S", 0.0)
    growing = LateCommand(LogWriter(tmp_path / "a.mcap", {}, live=True))
    save_growing(tmp_path / "a.mcap", tmp_path / "a.rrd", stop=growing)
    assert "who drives" in view_names(tmp_path / "a.rrd")


def wait_for_bytes(folder: Path, pattern: str, size: int) -> None:
    wait_until(lambda: any(path.stat().st_size >= size for path in folder.glob(pattern)))


def test_a_finished_log_is_shown_as_ever(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_rows(tmp_path / "a.mcap", 2)
    assert call(main, log, "--follow", "--save", tmp_path / "a.rrd") == 0
    (step,) = capsys.readouterr().err.splitlines()
    assert step.endswith(f"rerun {tmp_path / 'a.rrd'}`")
    entities = contents(tmp_path / "a.rrd")
    assert len(entities["/steering/recorded"]["Scalars:scalars"]) == 2
    assert "McapChannel:topic" in entities["/camera/center"]  # which its summary tells, at its end


def test_pictures_too_old_to_be_shown_are_reported_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("viz.live.follow.BEHIND_S", 0.0)
    writer = LogWriter(tmp_path / "a.mcap", {}, live=True)
    write_row(writer, 0)  # before there was a viewer: is shown

    class Taking(LogFeed):
        """Its viewer takes all; the rest of the log is written when it has taken the first row."""

        def _connected(self, name: str) -> rr.RecordingStream:
            return rr.RecordingStream(name)

        def _flush(self, recording: rr.RecordingStream) -> None:
            if not (tmp_path / "a.mcap").exists():
                for row in range(1, ROWS):
                    write_row(writer, row)
                writer.close()

    follower = Taking(writer.part, "")
    follower.run()
    finished, skipped = capsys.readouterr().err.splitlines()
    assert finished == "bc-play: a.mcap is finished"
    reported = f"pictures not shown, to keep up (the log has them): {4 * (ROWS - 2)}"  # but the last row's
    assert skipped.startswith(f"bc-play: skipped {reported} (/camera/center row 1, ")
    assert follower.code == 3


class Following(Process):
    """`bc-play --follow --web` on free ports."""

    def __init__(self, log: Path) -> None:
        self.web_port, self.port = free_ports(2)
        flags = ("--follow", "--web", "--web-port", self.web_port, "--port", self.port)
        super().__init__(command("bc-play", log, *flags))

    def wait_for_viewer(self) -> psutil.Process:
        self.wait_for("open that address in a browser")
        return wait_until(self._viewer)

    def _viewer(self) -> psutil.Process | None:
        children = psutil.Process(self.popen.pid).children(recursive=True)
        return next((child for child in children if set(listening(child)) == {self.web_port, self.port}), None)

    def __exit__(self, *exception: object) -> None:
        if self.popen.poll() is None:  # the test has failed
            for child in psutil.Process(self.popen.pid).children(recursive=True):
                child.kill()
        super().__exit__(*exception)


RECORDER = f"""
import sys, time
from pathlib import Path
from recorder import LogWriter

writer = LogWriter(Path(sys.argv[1]), {{}}, live=True)
for row in range({ROWS}):
    writer.picture("center", row, row, bytes([row]) * 300_000)
print("part", writer.part, file=sys.stderr, flush=True)
time.sleep(1000)
"""


def test_a_killed_recording_is_shown_as_far_as_it_is_whole(tmp_path: Path) -> None:
    rrd = tmp_path / "live.rrd"
    with Process([sys.executable, "-c", RECORDER, str(tmp_path / "live.mcap")]) as recording:
        part = Path(recording.wait_for("^part (.*)$")[1])
        text = f"{part}: its recording was killed; all complete chunks are shown; `bc-log recover {part}`"
        save = Process(command("bc-play", part, "--follow", "--save", rrd))
        with save, Following(part) as window:
            viewer = window.wait_for_viewer()
            wait_for_bytes(tmp_path, "live.rrd.*.part", 1000)
            recording.end(signal.SIGKILL)
            assert save.join() == 3
            assert text in save.stderr[0]
            window.wait_for(re.escape(text))
            assert viewer.is_running()
            assert window.end(signal.SIGINT) == 130
    blobs = contents(rrd)["/camera/center"]["EncodedImage:blob"]
    assert [(blob[0][0], len(blob[0])) for blob in blobs] == [(row, 300_000) for row in range(ROWS)]


def test_what_was_cut_off_by_a_kill_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("viz.live.live_log.QUIET_S", 0.0)
    data = write_rows(tmp_path / "a.mcap").read_bytes()
    part = tmp_path / "a.mcap.ab12cd.part"
    part.write_bytes(data[: data.index(picture(5, 1)) + 1000])
    assert call(main, part, "--follow", "--save", tmp_path / "a.rrd") == 3
    printed = capsys.readouterr().err
    assert "killed" in printed
    assert f"to {part.stat().st_size:,}" in printed
    part.write_bytes(b"")
    assert call(main, part, "--follow", "--save", tmp_path / "b.rrd") == 1
    assert "killed before it wrote anything" in capsys.readouterr().err
    assert not list(tmp_path.glob("b.rrd*"))


def received(port: int, rrd: Path) -> subprocess.Popen[bytes]:
    """Another client of the viewer, which writes what the viewer has, until the viewer ends."""
    address = f"rerun+http://127.0.0.1:{port}/proxy"
    line = [str(viewer_program()), address, "--save", str(rrd), "--bind", "127.0.0.1", "--port", "auto"]
    return subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment())


def test_the_viewer_is_served_to_this_machine_only_and_is_complete(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "live.mcap", {}, live=True)
    with Following(writer.part) as play:
        viewer = play.wait_for_viewer()
        assert listening(viewer) == {play.web_port: "127.0.0.1", play.port: "127.0.0.1"}
        for row in range(ROWS):
            write_row(writer, row)
        writer.close()
        play.wait_for(r"live\.mcap is finished")
        assert viewer.is_running()
        with received(play.port, tmp_path / "got.rrd") as client:
            wait_until(lambda: arrived(tmp_path / "got.rrd", "/camera/left", "EncodedImage:blob") == ROWS)
            wait_until(lambda: arrived(tmp_path / "got.rrd", "/steering/sent", "Scalars:scalars") == ROWS)
            assert play.end(signal.SIGINT) == 130
            client.wait(PATIENCE_S)
    assert not viewer.is_running()
    assert play.stderr[-1] == "bc-play: stopped"
    assert f"http://127.0.0.1:{play.web_port}/" in play.stdout
    entities = contents(tmp_path / "got.rrd")
    assert [blob[0] for blob in entities["/camera/left"]["EncodedImage:blob"]] == [
        list(picture(row, 1)) for row in range(ROWS)
    ]
    assert len(entities["/steering/sent"]["Scalars:scalars"]) == ROWS


def test_a_viewer_that_dies_or_freezes_harms_nobody_and_leaves_no_process(tmp_path: Path) -> None:
    for name, number in (("dies", signal.SIGKILL), ("freezes", signal.SIGSTOP)):
        with LogWriter(tmp_path / f"{name}.mcap", {}, live=True) as writer, Following(writer.part) as play:
            viewer = play.wait_for_viewer()
            viewer.send_signal(number)
            for row in range(2 * ROWS):
                write_row(writer, row)
            if number == signal.SIGSTOP:
                assert play.end(signal.SIGINT) == 130
            else:
                assert play.join() == 1
                assert "viewer was killed" in play.stderr[-1]
        assert not viewer.is_running()
        assert len(read_messages(tmp_path / f"{name}.mcap")["/vehicle"]) == 2 * ROWS
        assert not any("Traceback" in line for line in play.stderr), play.stderr
