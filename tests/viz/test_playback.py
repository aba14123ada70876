"""What the viewer is given: read back from the .rrd by Rerun's own reader, not by the code that wrote it."""

from __future__ import annotations

import os
import signal
import socket
from pathlib import Path

import psutil  # type: ignore[import-untyped]  # comes with rerun-sdk
import pytest

from common.preview import has_display
from recorder import LogError, LogWriter
from recorder.bc_pb2 import PilotCommand, VehicleState
from tests.helpers.driving import Process, command, one_line_in, one_line_of, road_jpeg, run
from tests.helpers.mcap_conformance import variants
from tests.helpers.plain_mcap import plain_writer
from tests.helpers.ports import free_ports
from tests.helpers.rrd import contents, view_names
from tests.helpers.udacity import call
from viz import save_rrd
from viz.cli import main

ROWS = 40
START_NS = 1_767_225_600 * 10**9
STATE_PLOTS = {"steering, -1 left .. 1 right", "speed, mph", "throttle and brake", "frames by steering, 25 bins"}


def write_log(path: Path, *, is_drive: bool) -> Path:
    """A session of three cameras, or a drive of one with crops, commands and an event."""
    with LogWriter(path, {"source": "test"}) as log:
        for i in range(ROWS):
            time_ns = START_NS + i * 100_000_000
            log.picture("center", time_ns, i, road_jpeg(i))
            if not is_drive:
                log.picture("left", time_ns, i, road_jpeg(i + 1))
                log.picture("right", time_ns, i, road_jpeg(i + 2))
            log.vehicle(time_ns, i, VehicleState(steering=i / 100, throttle=0.5, brake=0.25, speed_mph=i))
            if is_drive:
                log.crop(time_ns, i, road_jpeg(i))
                command = PilotCommand(
                    predicted_steering=-i / 50, steering=-i / 60, throttle=0.1, set_speed_mph=10
                )
                log.command(time_ns, i, command)
        if is_drive:
            log.event(START_NS, "connected")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("viz")


@pytest.fixture(scope="module")
def session(folder: Path) -> Path:
    save_rrd(write_log(folder / "session.mcap", is_drive=False), folder / "session.rrd")
    return folder / "session.rrd"


@pytest.fixture(scope="module")
def drive(folder: Path) -> Path:
    save_rrd(write_log(folder / "drive.mcap", is_drive=True), folder / "drive.rrd")
    return folder / "drive.rrd"


def test_the_recorded_curves_have_the_logs_values_at_the_logs_times(session: Path) -> None:
    entities = contents(session)
    expected = {
        "/steering/recorded": [i / 100 for i in range(ROWS)],
        "/speed_mph/driven": [float(i) for i in range(ROWS)],
        "/pedals/throttle": [0.5] * ROWS,
        "/pedals/brake": [0.25] * ROWS,
    }
    for entity, values in expected.items():
        assert [value[0] for value in entities[entity]["Scalars:scalars"]] == pytest.approx(values)
        assert entities[entity]["message_log_time"] == [START_NS + i * 100_000_000 for i in range(ROWS)]


def test_a_drive_has_the_crop_and_what_was_predicted_and_sent(drive: Path) -> None:
    entities = contents(drive)
    assert (
        len(entities["/pilot/input"]["EncodedImage:blob"])
        == len(entities["/camera/center"]["EncodedImage:blob"])
        == ROWS
    )
    predicted = [value[0] for value in entities["/steering/predicted"]["Scalars:scalars"]]
    sent = [value[0] for value in entities["/steering/sent"]["Scalars:scalars"]]
    assert predicted == pytest.approx([-i / 50 for i in range(ROWS)])
    assert sent == pytest.approx([-i / 60 for i in range(ROWS)])
    assert [value[0] for value in entities["/speed_mph/set"]["Scalars:scalars"]] == [10.0] * ROWS
    assert entities["/events"]["TextLog:text"] == [["connected"]]
    assert "/camera/left" not in entities


def test_the_layout_has_a_view_for_what_the_log_holds_only(session: Path, drive: Path) -> None:
    assert view_names(session) == STATE_PLOTS | {"centre camera", "left camera", "right camera"}
    of_drive = {"centre camera", "what the network sees", "who drives", "latency, ms", "events"}
    assert view_names(drive) == STATE_PLOTS | of_drive


def unfinished(path: Path, *, messages_kept: float) -> Path:
    """What a killed recording leaves: the log's first part, up to the middle of a chunk."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", 256)  # some rows each, as live logs have them
        whole = write_log(path.with_name("whole.mcap"), is_drive=False).read_bytes()
    path.write_bytes(whole[: int(messages_kept * len(whole))])
    return path


def test_an_unfinished_log_shows_what_is_whole_in_it_and_reports_so(session: Path, tmp_path: Path) -> None:
    log = unfinished(tmp_path / "killed.mcap.ab12cd.part", messages_kept=0.8)
    done = run("bc-play", log, "--save", tmp_path / "x.rrd")
    assert done.returncode == 3
    line, _ = done.stderr.splitlines()
    assert f"{log}: unfinished" in line
    entities, whole = contents(tmp_path / "x.rrd"), contents(session)
    rows = len(entities["/steering/recorded"]["message_log_time"])
    assert 10 < rows < ROWS
    assert (
        entities["/steering/recorded"]["Scalars:scalars"] == whole["/steering/recorded"]["Scalars:scalars"][:rows]
    )
    shown = entities["/camera/center"]["EncodedImage:blob"]
    assert shown == whole["/camera/center"]["EncodedImage:blob"][: len(shown)]
    assert len(shown) >= rows
    assert log.stat().st_size == int(0.8 * (tmp_path / "whole.mcap").stat().st_size)
    assert {path.name for path in tmp_path.iterdir()} == {log.name, "whole.mcap", "x.rrd"}


@pytest.mark.parametrize("flags", [["--web"], ["--save", "x.rrd"], ["--follow"]])
def test_bc_play_refuses_an_empty_log_before_a_viewer_opens(
    flags: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("viz.cli._show_or_save", lambda config, content: pytest.fail("too late"))
    monkeypatch.chdir(tmp_path)
    LogWriter(tmp_path / "empty.mcap", {}).close()
    assert call(main, "empty.mcap", *flags) == 1
    (tmp_path / "other.mcap").write_bytes(next(data for name, _, data in variants() if name == "NoData"))
    assert call(main, "other.mcap", *flags) == 1
    printed = capsys.readouterr().err
    assert "empty.mcap: an empty log" in printed
    assert "other.mcap: an empty log" in printed


def test_a_log_shows_what_it_has(tmp_path: Path) -> None:
    """Pictures without vehicle states, states without pictures."""
    with LogWriter(tmp_path / "pictures.mcap", {}) as log:
        log.picture("left", 1, 0, road_jpeg(0))
    with LogWriter(tmp_path / "states.mcap", {}) as log:
        log.vehicle(1, 0, VehicleState(steering=0.5))
    for name in ("pictures", "states"):
        save_rrd(tmp_path / f"{name}.mcap", tmp_path / f"{name}.rrd")
    pictures, states = contents(tmp_path / "pictures.rrd"), contents(tmp_path / "states.rrd")
    assert [bytes(blob[0]) for blob in pictures["/camera/left"]["EncodedImage:blob"]] == [road_jpeg(0)]
    assert "/steering/recorded" not in pictures
    assert states["/steering/recorded"]["Scalars:scalars"] == [[0.5]]
    assert "left camera" in view_names(tmp_path / "pictures.rrd")
    assert not {name for name in view_names(tmp_path / "states.rrd") if "camera" in name}


@pytest.mark.parametrize("given", ["OneMessage", "TenMessages"])
def test_another_programs_log_is_shown_also_without_indexes(given: str, tmp_path: Path) -> None:
    """Rerun's reader finds only what the log's end lists."""
    path, features = tmp_path / "a.mcap", ("", "-pad", "-st", "-ch", "-ch-chx-rch-rsh-st", "-ch-chx-mx-rch-rsh-st")
    files = {name: data for name, of, data in variants() if of.name == given}
    messages = next(of.messages for _, of, _ in variants() if of.name == given)
    for name in features:
        path.write_bytes(files[given + name])
        assert call(main, path, "--save", tmp_path / "a.rrd", "--force") == 0
        times = contents(tmp_path / "a.rrd")["/example"]["message_log_time"]
        assert times == sorted(time_ns for _, time_ns, _ in messages)


def test_what_rerun_cannot_show_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with plain_writer(tmp_path / "a.mcap") as writer:
        schema = writer.register_schema("a.State", "protobuf", b"\xff no schema")
        writer.add_message(writer.register_channel("/a", "protobuf", schema), START_NS, b"", START_NS)
    assert call(main, tmp_path / "a.mcap", "--save", tmp_path / "a.rrd") == 1
    assert one_line_in(capsys).startswith(f"bc-play: {tmp_path / 'a.mcap'}: Rerun cannot show it (")
    assert not (tmp_path / "a.rrd").exists()


def test_what_is_no_log_is_one_line(tmp_path: Path) -> None:
    log = tmp_path / "photo.mcap"
    log.write_bytes(road_jpeg(0))
    with pytest.raises(LogError):
        save_rrd(log, tmp_path / "x.rrd")
    for flags in (("--save", tmp_path / "x.rrd"), ("--web",), (log, "--web")):
        done = run("bc-play", log, *flags)
        assert done.returncode == 1
        assert str(log) in one_line_of(done)  # and no page, which would show nothing
    assert list(tmp_path.iterdir()) == [log]


@pytest.mark.parametrize(
    ("platform", "variables", "expected"),
    [
        ("linux", {}, False),
        ("linux", {"DISPLAY": ""}, False),
        ("linux", {"DISPLAY": ":0"}, True),
        ("linux", {"WAYLAND_DISPLAY": "wayland-0"}, True),
        ("darwin", {}, True),
        ("win32", {}, True),
    ],
)
def test_there_is_a_display_where_a_window_can_open(
    platform: str, variables: dict[str, str], expected: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("sys.platform", platform)
    assert has_display() is expected


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no signals there")
@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.long)])
def test_a_viewer_that_dies_is_one_line_and_exit_code_1(drive: Path, number: signal.Signals) -> None:
    web_port, port = free_ports(2)
    flags = ("--web", "--web-port", web_port, "--port", port)
    with Process(command("bc-play", drive.with_suffix(".mcap"), *flags)) as play:
        play.wait_for("open that address in a browser")
        (viewer,) = psutil.Process(play.popen.pid).children()
        viewer.send_signal(number)
        assert play.join() == 1
    assert f"viewer was killed (signal {number.value})" in play.stderr[-1]
    assert len(play.stderr) == 3  # after those of the page's address


def test_a_port_that_is_taken_is_one_line(drive: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = run("bc-play", drive.with_suffix(".mcap"), "--web", "--port", port, "--web-port", *free_ports(1))
    assert done.returncode == 1
    assert f"port {port}" in one_line_of(done)


@pytest.mark.parametrize(
    "words",
    [("--connect", "a b.mcap"), ("c.mcap", "--connect", "9911", "a b.mcap"), ("--connect", "9911", "no.mcap")],
)
def test_a_log_behind_connect_is_reported_where_it_belongs(
    words: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a b.mcap").touch()
    assert call(main, *words) == 2
    assert capsys.readouterr().err.startswith("bc-play: --connect takes one address; put it after the logs")
