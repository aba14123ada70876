"""Where a log opens in the viewer: at its beginning, or where --at says, on a clock of seconds since its start."""

from __future__ import annotations

import contextlib
import os
import shlex
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from common import UserError
from tests.helpers.driving import PATIENCE_S, road_jpeg
from tests.helpers.logs import STEP_NS, write_log
from tests.helpers.ports import free_ports
from tests.helpers.rrd import contents
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until
from viz.cli import main
from viz.viewer_process import LOCAL, Ports, Viewer, end_viewer, viewer_program, wait_until_it_listens

ROWS = 50
LENGTH_S = (ROWS - 1) * STEP_NS * 1e-9


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("at")
    return write_log(folder / "a.mcap", [row / 100 for row in range(ROWS)], lambda camera, row: road_jpeg(row))


def time_panel(rrd: Path) -> dict[str, Any]:
    """What the layout says of the time panel, by component."""
    reader = RrdReader(rrd)
    (blueprint,) = reader.blueprints()
    components: dict[str, Any] = {}
    for chunk in reader.stream(store=blueprint).to_chunks():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if name.startswith("TimePanelBlueprint:"):
                components[name.partition(":")[2]] = batch.column(name).to_pylist()[-1][0]
    return components


PAUSED, PLAYING, SELECTION = 1, 2, 2  # as Rerun numbers them


def test_a_log_opens_at_its_beginning_on_a_clock_of_seconds_since_then(log: Path, tmp_path: Path) -> None:
    assert call(main, log, "--save", tmp_path / "a.rrd") == 0
    panel = time_panel(tmp_path / "a.rrd")
    assert panel["timeline"] == "since start"
    assert panel["play_state"] == PAUSED
    assert "time_selection" not in panel
    entities = contents(tmp_path / "a.rrd")
    for entity in ("/camera/center", "/steering/recorded", "/camera/center/steering/recorded"):
        times = [time.total_seconds() for time in entities[entity]["since start"]]
        assert times == pytest.approx([row * STEP_NS * 1e-9 for row in range(ROWS)])


def test_in_a_file_the_seconds_around_a_moment_are_played_over_and_over(log: Path, tmp_path: Path) -> None:
    assert call(main, log, "--at", 2.5, "--save", tmp_path / "a.rrd") == 0
    panel = time_panel(tmp_path / "a.rrd")
    assert (panel["play_state"], panel["loop_mode"]) == (PLAYING, SELECTION)
    assert panel["time_selection"] == {"min": 1_500_000_000, "max": 3_500_000_000}
    assert call(main, log, log, "--at", 0.25, "--save", tmp_path / "b.rrd") == 0
    assert time_panel(tmp_path / "b.rrd")["time_selection"] == {"min": 0, "max": 1_250_000_000}


@contextlib.contextmanager
def headless_viewer(folder: Path) -> Iterator[ViewerClient]:
    """A viewer with all but a window. It has drawn once: without a graphics driver, it may answer before it
    panics."""
    (port,) = free_ports(1)
    url = Ports(0, port).data_address
    line = [str(viewer_program()), "--headless", "--bind", LOCAL, "--port", str(port)]
    viewer = Viewer(line, {**os.environ, "RUST_LOG": "error"})
    try:
        wait_until_it_listens(viewer, url)
        client = ViewerClient.connect(url)
        client.save_screenshot(str(folder / "first.png"))
    except (OSError, RuntimeError, UserError):
        with contextlib.suppress(subprocess.TimeoutExpired):
            viewer.wait(PATIENCE_S)
        end_viewer(viewer)
        if reason := viewer.failure_reason():
            pytest.skip(f"a viewer was not tried: it {reason}")
        raise
    try:
        yield client
    finally:
        end_viewer(viewer)


def test_a_viewer_stands_at_the_moment_that_was_asked_for(log: Path, tmp_path: Path) -> None:
    with headless_viewer(tmp_path) as viewer:
        port = viewer.url.rpartition(":")[2].partition("/")[0]
        for flags, expected_s in ((("--at", 2.5), 2.5), ((), 0.0)):
            before = {recording.store_id for recording in viewer.get_state().recordings}
            assert call(main, log, "--connect", port, *flags) == 0

            def shown() -> float | None:
                opened = viewer.get_state().recordings
                new = [recording for recording in opened if recording.store_id not in before]  # noqa: B023
                return new[0].current_time if new and new[0].current_timeline == "since start" else None

            assert wait_until(lambda: shown() is not None)
            assert (shown() or 0) * 1e-9 == pytest.approx(expected_s, abs=1e-6)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--at", "60"), f"--at 60: {{log}} is {LENGTH_S:.1f} s long"),
        (("--at", "-1"), "--at -1: expected seconds since the log's start"),
        (("--at", "nan"), "--at nan: expected seconds since the log's start"),
        (("--at", "1", "--follow"), "give it without --follow"),
        (("{log}", "--at", "1", "--by", "place"), "without --follow, --by place"),
        (("--at", "1", "--video", "x.mp4"), "give it without --at"),
    ],
)
def test_a_moment_that_cannot_be_is_one_line(
    flags: tuple[str, ...], message: str, log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = () if "--video" in flags else ("--save", tmp_path / "a.rrd")
    code = 1 if "s long" in message else 2  # how long a log is, its flags do not tell
    assert call(main, log, *(flag.format(log=log) for flag in flags), *saved) == code
    (line,) = capsys.readouterr().err.splitlines()
    assert message.format(log=log) in line
    assert not list(tmp_path.iterdir())


# A viewer that cannot draw


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="a script cannot stand in for the viewer there")
@pytest.mark.parametrize(
    ("last_words", "message"),
    [
        ("Error: WGPU error: Failed to create surface for any enabled backend: {}", "mesa-vulkan-drivers"),
        (
            "thread 'main' panicked at 'Failed to get render context'\nmain.rs:1\n6: panic_fmt",
            "mesa-vulkan-drivers",
        ),
        ("Error: winit EventLoopError: os error: Failed to open connection to X server", "on this display"),
        ("Error: something else", "failed (exit code 1)"),
    ],
)
def test_a_viewer_that_cannot_draw_reports_what_helps(
    last_words: str,
    message: str,
    log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """These words are Rerun's own, of a machine without graphics, and without that display."""
    stand_in = tmp_path / "rerun"
    stand_in.write_text(f"#!/bin/sh\necho 'a note' >&2\necho {shlex.quote(last_words)} >&2\nexit 1\n")
    stand_in.chmod(stand_in.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setattr("viz.viewer_process.viewer_program", lambda: stand_in)
    monkeypatch.setenv("DISPLAY", ":77")
    assert call(main, log) == 1
    note, *lines, printed = capfd.readouterr().err.splitlines()
    assert note == "a note"
    assert lines == ([] if "exit code" not in message else [last_words])
    assert printed.startswith("bc-play: the Rerun viewer ")
    assert message in printed
