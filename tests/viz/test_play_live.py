"""The viewer beside what goes on, and viewers that run already: what they get, what is said of those not there."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import psutil  # type: ignore[import-untyped]  # comes with rerun-sdk
import pytest

from common import UserError
from common.car import CAMERAS, Camera
from common.preview import preview
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from tests.helpers.driving import Process, environment
from tests.helpers.logs import START_NS, STEP_NS, write_log
from tests.helpers.ports import free_ports
from tests.helpers.rrd import arrived, contents, lives
from tests.helpers.udacity import call
from tests.helpers.waiting import PATIENCE_S, wait_until
from viz.cli import main
from viz.viewer_connection import ViewerFeed, feed_viewer
from viz.viewer_process import Ports, open_viewer, viewer_program, wait_until_it_listens

ROWS = 30

not_on_windows = pytest.mark.skipif(sys.platform == "win32", reason="an open log cannot be renamed there")


def picture(camera: Camera, row: int) -> bytes:
    """What cannot be compressed: a file is then at least as large as the pictures in it."""
    return random.Random(f"{camera} {row}").randbytes(8000)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    steering = [row / 100 for row in range(ROWS)]
    return write_log(tmp_path_factory.mktemp("live") / "a.mcap", steering, picture)


@contextlib.contextmanager
def running_viewer() -> Iterator[Ports]:
    """A viewer that serves browsers: it needs neither a display nor a graphics driver."""
    ports = Ports(*free_ports(2))
    with open_viewer(ports, web=True) as viewer:
        wait_until_it_listens(viewer, ports.data_address)
        yield ports


@contextlib.contextmanager
def received(ports: Ports, rrd: Path, pictures: int = ROWS) -> Iterator[None]:
    """Another client of the viewer writes all that it has to a file, until the viewer is ended within."""
    line = [str(viewer_program()), ports.data_address, "--save", str(rrd), "--bind", "127.0.0.1", "--port", "auto"]
    with subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment()) as client:
        for camera in CAMERAS:
            wait_until(lambda: arrived(rrd, f"/camera/{camera}", "EncodedImage:blob") >= pictures)  # noqa: B023
        wait_until(lambda: arrived(rrd, "/steering/recorded", "Scalars:scalars") >= ROWS)
        yield
        client.wait(PATIENCE_S)


def holds_all(rrd: Path) -> bool:
    entities = contents(rrd)
    pictures = [
        [bytes(blob[0]) for blob in entities[f"/camera/{camera}"]["EncodedImage:blob"]] for camera in CAMERAS
    ]
    return pictures == [[picture(camera, row) for row in range(ROWS)] for camera in CAMERAS] and [
        value[0] for value in entities["/steering/recorded"]["Scalars:scalars"] if value
    ] == pytest.approx([row / 100 for row in range(ROWS)])


# A viewer that runs


def test_a_viewer_that_runs_gets_all_of_the_log(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with contextlib.ExitStack() as client, running_viewer() as ports:
        assert call(main, log, "--connect", f"127.0.0.1:{ports.data}") == 0
        client.enter_context(received(ports, tmp_path / "got.rrd"))
    assert holds_all(tmp_path / "got.rrd")
    printed = capsys.readouterr()
    version, step = printed.err.splitlines()
    assert "its version is unknown" in version  # what serves browsers does not
    assert step.endswith(f"bc-log info {log}`")
    assert printed.out == f"a.mcap: sent to 127.0.0.1:{ports.data}\n"


def test_of_a_large_log_a_viewer_gets_some_rows_pictures_and_all_curves(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("viz.targets._LARGE", 1)
    monkeypatch.setattr("viz.targets._SENT", log.stat().st_size / 7.5)
    with contextlib.ExitStack() as client, running_viewer() as ports:
        assert call(main, log, "--connect", ports.data) == 0
        client.enter_context(received(ports, tmp_path / "got.rrd", 5))
    entities = contents(tmp_path / "got.rrd")
    for camera in CAMERAS:
        blobs = [bytes(blob[0]) for blob in entities[f"/camera/{camera}"]["EncodedImage:blob"]]
        assert blobs == [picture(camera, row) for row in (0, 8, 16, 24, 29)]
    assert len(entities["/steering/recorded"]["Scalars:scalars"]) >= ROWS
    assert "one picture of 8" in capsys.readouterr().err


def test_what_a_running_viewer_does_not_get_of_a_damaged_log_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_log(tmp_path / "a.mcap", [row / 100 for row in range(ROWS)], picture)
    damaged = bytearray(log.read_bytes())
    damaged[damaged.index(picture("center", 0)) + 30] ^= 1
    log.write_bytes(damaged)
    with running_viewer() as ports:
        assert call(main, log, "--connect", ports.data) == 3
    printed = capsys.readouterr()
    assert printed.out == f"a.mcap: sent to 127.0.0.1:{ports.data}\n"
    assert printed.err.splitlines()[-2].startswith("bc-play: skipped pictures in damaged chunks of ")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no Ctrl-C for one thread alone")
def test_ctrl_c_waits_for_what_is_being_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else its progress bar would still stand where the last line is printed."""
    monkeypatch.setattr("viz.viewer_connection.LAST_DATA_S", PATIENCE_S)
    ended = []

    class Slow(ViewerFeed):
        def run(self) -> None:
            time.sleep(0.1)
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
            self.stop.wait(PATIENCE_S)
            time.sleep(0.1)
            ended.append(self)

    with pytest.raises(KeyboardInterrupt):
        feed_viewer(Slow(""), None)
    assert ended


@contextlib.contextmanager
def answering(answer: bytes) -> Iterator[int]:
    """The port of a server that says something else than a viewer."""

    def serve() -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = server.accept()
                with connection:
                    connection.recv(100)
                    connection.sendall(answer)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield server.getsockname()[1]
        server.shutdown(socket.SHUT_RDWR)
        thread.join(PATIENCE_S)


def test_what_is_no_viewer_is_one_line(
    log: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def printed(port: object, code: int = 1) -> str:
        assert call(main, log, "--connect", port) == code
        (line,) = capsys.readouterr().err.splitlines()
        return line

    (nobody,) = free_ports(1)
    assert f"127.0.0.1:{nobody}: no viewer listens" in printed(nobody)
    with answering(b"HTTP/1.0 400 Bad request\r\n\r\n") as port:
        assert "is not a Rerun viewer" in printed(port)
    with answering(b"") as port:
        assert "is not a Rerun viewer" in printed(port)
    with socket.create_server(("127.0.0.1", 0)) as silent, monkeypatch.context() as patched:  # a frozen one
        patched.setattr("viz.viewer_connection._PATIENCE_S", 0.2)
        assert "no answer" in printed(silent.getsockname()[1])
    assert "expected HOST:PORT, or PORT on this machine" in printed("somewhere", code=2)
    assert "no viewer listens" in printed("99999")


def test_a_viewer_of_another_version_is_refused_with_the_needed_one(
    log: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "viz.viewer_connection._version", lambda url: "0.7.1"
    )  # none of so old a version is installed
    with running_viewer() as ports:
        assert call(main, log, "--connect", ports.data) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "a viewer of version 0.7.1, but version 0." in line


# Beside what goes on


def test_what_is_no_place_for_a_viewer_is_refused_before_anything_begins(tmp_path: Path) -> None:
    (tmp_path / "x.rrd").write_bytes(b"precious")
    for where, message in (
        ("windwo", "^--viewer windwo: expected window, web, a FILE"),
        ("", "expected window, web, a FILE"),
        ("--web", "expected window, web, a FILE"),
        (str(tmp_path / "x.rrd"), "exists already"),
    ):
        with pytest.raises(UserError, match=message), preview(tmp_path / "a.mcap", where):
            raise AssertionError("it has begun")
    assert (tmp_path / "x.rrd").read_bytes() == b"precious"


def line_from(capfd: pytest.CaptureFixture[str]) -> str:
    """What other processes have said on stderr, as soon as that is a line."""
    printed: list[str] = []

    def has_said() -> bool:
        printed.append(capfd.readouterr().err)
        return printed[-1].endswith("\n")

    wait_until(has_said)
    return "".join(printed)


def test_a_viewer_that_cannot_start_reports_why_and_disturbs_nothing(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (nobody,) = free_ports(1)
    with LogWriter(tmp_path / "a.mcap", {}, live=True) as writer:
        with preview(writer.part, f"127.0.0.1:{nobody}"):
            writer.vehicle(START_NS, 0, VehicleState(steering=0.5))
            printed = line_from(capfd)
            assert printed.startswith(f"viewer: 127.0.0.1:{nobody}: no viewer listens")
            again = f"bc-play {tmp_path / 'a.mcap'} --follow"
            assert printed.endswith(
                f"; everything else continues; `{again}` opens another viewer, `{again} --web` opens it in a"
                " browser\n"
            )
        writer.vehicle(START_NS + STEP_NS, 1, VehicleState(steering=0.5))
    assert call(main, tmp_path / "a.mcap", "--save", tmp_path / "a.rrd") == 0


@pytest.mark.skipif(sys.platform != "linux", reason="a window can always open there")
def test_a_window_that_cannot_open_names_a_command_and_only_its_own_flags(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Rerun's own viewer, on a display that is none: as bc-drive, bc-record and bc-train open it."""
    monkeypatch.setenv("DISPLAY", ":77")
    with LogWriter(tmp_path / "a.mcap", {}, live=True) as writer, preview(writer.part):
        writer.vehicle(START_NS, 0, VehicleState(steering=0.5))
        printed = line_from(capfd)
    again = f"bc-play {tmp_path / 'a.mcap'} --follow"
    assert printed.startswith("viewer: the Rerun viewer ")
    assert "give --web" not in printed
    assert printed.endswith(
        f"; everything else continues; `{again}` opens another viewer, `{again} --web` opens it in a browser\n"
    )


def test_a_viewer_that_runs_gets_the_end_of_the_log_before_it_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("common.preview.CONNECTED_GRACE_S", PATIENCE_S)
    writer = LogWriter(tmp_path / "a.mcap", {}, live=True)
    with contextlib.ExitStack() as client, running_viewer() as ports:
        with preview(writer.part, f"127.0.0.1:{ports.data}", notify=print):
            for row in range(ROWS):
                for camera in CAMERAS:
                    writer.picture(camera, START_NS + row * STEP_NS, row, picture(camera, row))
                writer.vehicle(START_NS + row * STEP_NS, row, VehicleState(steering=row / 100))
            writer.close()
        client.enter_context(received(ports, tmp_path / "got.rrd"))
    assert holds_all(tmp_path / "got.rrd")
    printed = capfd.readouterr().err
    assert "a.mcap: sent to" in printed or "viewer: a.mcap is finished, all of it is shown" in printed
    assert "stopped" not in printed


def test_a_file_has_all_that_was_written_before_it_is_left(tmp_path: Path) -> None:
    """Also what was written when the viewer's process had not even begun to read."""
    writer = LogWriter(tmp_path / "a.mcap", {}, live=True)
    with preview(writer.part, str(tmp_path / "a.rrd")):
        for row in range(ROWS):
            for camera in CAMERAS:
                writer.picture(camera, START_NS + row * STEP_NS, row, picture(camera, row))
            writer.vehicle(START_NS + row * STEP_NS, row, VehicleState(steering=row / 100))
        writer.close()
    assert holds_all(tmp_path / "a.rrd")


PREVIEW = """
import sys, time
from pathlib import Path
from common.preview import preview
with preview(Path(sys.argv[1]), sys.argv[2]):
    time.sleep(1000)
"""


def children_of(process: int) -> list[psutil.Process]:
    return list(psutil.Process(process).children(recursive=True))


@not_on_windows
def test_a_preview_ends_when_who_started_it_is_killed(tmp_path: Path) -> None:
    """As when a terminal is closed. What lies in the working folder is not taken for our own modules."""
    for name in ("common.py", "viz.py"):
        (tmp_path / name).write_text("raise SystemExit('of another project')")  # not taken for ours
    with LogWriter(tmp_path / "a.mcap", {}, live=True) as writer:
        writer.vehicle(START_NS, 0, VehicleState(steering=0.5))
        line = [sys.executable, "-P", "-c", PREVIEW, str(writer.part), "a.rrd"]
        with Process(line, cwd=tmp_path) as process:
            wait_until(lambda: list(tmp_path.glob("a.rrd.*.part")))
            previews = children_of(process.popen.pid)
            try:
                process.popen.kill()
                process.popen.wait(PATIENCE_S)
                wait_until(lambda: not any(map(lives, previews)))
            finally:
                for viewer in previews:
                    with contextlib.suppress(psutil.NoSuchProcess):
                        viewer.kill()
    assert len(previews) == 1
    assert [path.name for path in tmp_path.glob("a.rrd*")] == ["a.rrd"]  # what was there by then


BEGINS_A_FILE = """
import sys, time
open(f"{sys.argv[-1]}.ab12cd.part", "x")
time.sleep(1000)
"""


@not_on_windows
def test_a_file_that_is_never_finished_is_said_and_nothing_of_it_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    for grace, seconds in (("FILE_GRACE_S", 0.2), ("NOTICE_AFTER_S", 0.1), ("EXIT_GRACE_S", 0.1)):
        monkeypatch.setattr(f"common.preview.{grace}", seconds)
    monkeypatch.setattr("common.preview.VIEWER", ("-c", BEGINS_A_FILE))
    others = set(children_of(os.getpid()))
    rrd, foreign = tmp_path / "a.rrd", tmp_path / "a.rrd.0123ab.part"
    foreign.write_bytes(b"another's")
    writer = LogWriter(tmp_path / "a.mcap", {}, live=True)
    with preview(writer.part, str(rrd)):
        writer.vehicle(START_NS, 0, VehicleState(steering=0.5))
        wait_until(lambda: len(list(tmp_path.glob("a.rrd.*.part"))) == 2)
        for child in set(children_of(os.getpid())) - others:
            child.suspend()
        writer.close()
    assert list(tmp_path.glob("a.rrd*")) == [foreign]
    waits, line = capfd.readouterr().err.splitlines()
    assert waits.startswith(f"finishing {rrd}, ")
    assert line.startswith(f"{rrd}: not written")
    assert f"`bc-play {tmp_path / 'a.mcap'} --save {rrd}`" in line
