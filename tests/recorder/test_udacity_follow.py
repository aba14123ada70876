"""A recording is followed while it is written: tests append to it as the simulator does, and look at the log."""

from __future__ import annotations

import os
import shutil
import signal
import struct
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from mcap_protobuf.decoder import DecoderFactory

from common import UserError
from common.car import CAMERAS
from recorder import Imported, RecordingError, import_udacity
from recorder.sources.udacity_follow import watch_udacity
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import PATIENCE_S, Process
from tests.helpers.logs import read_messages
from tests.helpers.udacity import jpeg, make_recording, paths, picture_name

Found = dict[str, set[tuple[int, int, object]]]
ROWS = [f"{paths(number)},{number / 100},0.5,0,{number + 0.25}" for number in range(6)]


def row_values(numbers: Sequence[int]) -> list[tuple[int, float]]:
    """(sequence, speed) of these lines of ROWS, as the log has them."""
    return [(sequence, number + 0.25) for sequence, number in enumerate(numbers)]


def picture(number: int, camera_number: int) -> bytes:
    return jpeg(60 * camera_number + number, 10 * number + camera_number + 1)


def contents(log: Path) -> Found:
    """The messages of a finished log by topic: sequence, time and content, in any order."""
    return {
        topic: {(message.sequence, message.log_time, message.data) for message, _ in messages}
        for topic, messages in read_messages(log).items()
    }


def growing(part: Path) -> dict[str, list[tuple[int, Any]]]:
    """What can be read of an unfinished log: (sequence, content) by topic."""
    by_topic: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    with part.open("rb") as stream:
        try:
            reader = NonSeekingReader(stream, decoder_factories=[DecoderFactory()])
            for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
                by_topic[channel.topic].append((message.sequence, decoded))
        except (McapError, EOFError, struct.error):  # it has no end yet
            pass
    return by_topic


class Drive:
    """The simulator's part: steps taken in a thread while the recording is watched."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.started = threading.Event()
        self.over = threading.Event()
        self.part = Path()

    def on_started(self, part: Path) -> None:
        self.part = part
        self.started.set()

    def append(self, text: str) -> None:
        self.folder.mkdir(exist_ok=True)
        with (self.folder / "driving_log.csv").open("a", newline="") as csv:
            csv.write(text)

    def render(self, number: int, cameras: Sequence[int] = (0, 1, 2)) -> None:
        (self.folder / "IMG").mkdir(parents=True, exist_ok=True)
        for camera in cameras:
            (self.folder / "IMG" / picture_name(CAMERAS[camera], number)).write_bytes(picture(number, camera))

    def speeds(self) -> list[tuple[int, float]]:
        return [(sequence, state.speed_mph) for sequence, state in growing(self.part)["/vehicle"]]

    def pictures(self) -> int:
        return sum(len(growing(self.part)[f"/camera/{camera}"]) for camera in CAMERAS)

    def wait_until(self, condition: Callable[[], bool]) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end_s, "the log never came so far"
            assert not self.over.is_set(), "the watch ended too early"
            time.sleep(0.02)


def watch(drive: Drive, log: Path, steps: Callable[[], None]) -> Imported:
    """Watch until the steps are done; then Ctrl-C."""
    failed: list[BaseException] = []

    def run_steps() -> None:
        try:
            drive.wait_until(drive.started.is_set)
            steps()
        except BaseException as error:
            failed.append(error)
        finally:
            if drive.started.is_set() and not drive.over.is_set():
                os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=run_steps)
    thread.start()
    try:
        return watch_udacity(drive.folder, log, on_started=drive.on_started)
    finally:
        drive.over.set()
        thread.join(PATIENCE_S)
        if failed:
            raise failed[0]


def test_a_finished_recording_gives_what_its_import_gives(tmp_path: Path) -> None:
    header = "center,left,right,steering,throttle,brake,speed"
    cut = f"{paths(4)},0.1"
    comma = f"{paths(5)},-0,5,0,25,0,3,75"
    lines = [header, ROWS[0], "", ROWS[1].replace(",", ", "), ROWS[0], cut, "junk", ROWS[3], comma, ROWS[2][:70]]
    folder = tmp_path / "drive"
    make_recording(folder, "\r\n".join(lines), [0, 1, 2, 3, 5, 9])
    (folder / "IMG" / picture_name("left", 1)).unlink()
    (folder / "IMG" / picture_name("right", 3)).write_bytes(jpeg(9)[:-100])
    (tmp_path / "private.jpg").write_bytes(jpeg(250))
    (folder / "IMG" / picture_name("left", 7)).symlink_to(tmp_path / "private.jpg")
    imported = import_udacity(folder, tmp_path / "imported.mcap")
    watched = watch_udacity(folder, tmp_path / "watched.mcap", idle_s=0)
    assert (imported.rows, imported.pictures) == (watched.rows, watched.pictures) == (4, 10)
    assert sorted(imported.skipped) == sorted(watched.skipped)
    assert contents(imported.path) == contents(watched.path)


def test_rows_and_pictures_are_logged_when_they_are_complete(tmp_path: Path) -> None:
    drive = Drive(tmp_path / "drive")

    def steps() -> None:
        drive.append(f"{ROWS[0]}\r\n{ROWS[1]}\r\n{ROWS[2][:-2]}")
        drive.wait_until(lambda: drive.speeds() == row_values([0, 1]))
        drive.append(f"{ROWS[2][-2:]}\r\n")
        drive.wait_until(lambda: drive.speeds() == row_values([0, 1, 2]))
        assert drive.pictures() == 0

        half = drive.folder / "IMG" / picture_name("center", 1)
        half.parent.mkdir()
        half.write_bytes(picture(1, 0)[:2000])
        drive.render(0)
        drive.render(1, [1, 2])
        drive.wait_until(lambda: drive.pictures() == 5)
        with half.open("ab") as file:
            file.write(picture(1, 0)[2000:])
        drive.render(3)  # before its row
        drive.render(2)
        drive.wait_until(lambda: drive.pictures() == 9)
        drive.append(f"{ROWS[3]}\r\n")
        drive.wait_until(lambda: drive.pictures() == 12)

    done = watch(drive, tmp_path / "watched.mcap", steps)
    assert (done.rows, done.pictures, list(done.skipped)) == (4, 12, [])
    assert not drive.part.exists()
    assert contents(done.path) == contents(import_udacity(drive.folder, tmp_path / "imported.mcap").path)


def test_a_csv_that_begins_again_adds_only_what_is_new(tmp_path: Path) -> None:
    drive = Drive(tmp_path / "drive")

    def steps() -> None:
        drive.append(f"{ROWS[0]}\n{ROWS[1]}\njunk\njunk\n")
        drive.wait_until(lambda: len(drive.speeds()) == 2)
        (drive.folder / "driving_log.csv").write_text(f"junk\n{ROWS[1]}\n{ROWS[3]}\n")
        drive.render(3)
        drive.wait_until(lambda: drive.speeds() == row_values([0, 1, 3]) and drive.pictures() == 3)

    done = watch(drive, tmp_path / "watched.mcap", steps)
    skipped = [name for reason, name in done.skipped if reason.startswith("rows")]
    assert skipped == ["line 3", "line 4", "line 1", "line 2"]
    assert (done.rows, done.pictures) == (3, 3)


def test_what_never_came_is_named_and_in_the_log(tmp_path: Path) -> None:
    folder = tmp_path / "drive"
    make_recording(folder, f"{ROWS[0]}\n{ROWS[1]}\n{ROWS[2]}", [0, 8])
    (folder / "IMG" / picture_name("left", 1)).write_bytes(jpeg(80)[:500])
    done = watch_udacity(folder, tmp_path / "watched.mcap", idle_s=0)
    assert (done.rows, done.pictures) == (3, 3)  # the last line has no end, but all of its values
    assert done.skipped.counts == {
        "pictures that a row names and no file has, or several have": 5,
        "pictures that are not whole JPEG or PNG files": 1,
        "pictures without a row": 3,
    }
    events = [event.message for _, event in read_messages(done.path)["/events"]]
    assert sorted(events) == sorted(f"skipped {reason}: {name}" for reason, name in done.skipped)


def test_nothing_came(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(RecordingError, match=r"driving_log\.csv: it never came"):
        watch_udacity(tmp_path / "nowhere", tmp_path / "sessions" / "watched.mcap", idle_s=0)
    assert list(tmp_path.iterdir()) == []
    assert f"waiting for {tmp_path / 'nowhere' / 'driving_log.csv'}" in capsys.readouterr().err


def test_links_out_of_the_recording_are_not_followed(tmp_path: Path) -> None:
    make_recording(tmp_path / "private", f"{ROWS[0]}\n", [0])
    folder = tmp_path / "downloaded"
    folder.mkdir()
    (folder / "driving_log.csv").symlink_to(tmp_path / "private" / "driving_log.csv")
    with pytest.raises(RecordingError, match="a link out of the recording"):
        watch_udacity(folder, tmp_path / "watched.mcap", idle_s=0)


def test_kill_ends_the_real_thing_and_a_killed_one_keeps_what_came(tmp_path: Path) -> None:
    code = "import sys; from pathlib import Path; from recorder.sources.udacity_follow import watch_udacity;"
    code += "done = watch_udacity(Path(sys.argv[1]), Path(sys.argv[2])); print(done.rows, done.pictures)"
    drive = Drive(tmp_path / "drive")

    def follow(name: str) -> Process:
        return Process([sys.executable, "-c", code, str(drive.folder), str(tmp_path / name)])

    with follow("ended.mcap") as ended, follow("killed.mcap") as killed:
        ended.wait_for(r"^waiting for .*driving_log\.csv$")
        killed.wait_for(r"^waiting for .*driving_log\.csv$")
        drive.append(f"{ROWS[0]}\n{ROWS[1]}\n")
        drive.render(0)
        for name in ("ended", "killed"):
            [drive.part] = tmp_path.glob(f"{name}.mcap.*.part")
            drive.wait_until(lambda: len(drive.speeds()) == 2 and drive.pictures() == 3)
        assert ended.end(signal.SIGTERM) == 0
        assert ended.stdout == "2 3\n"
        assert killed.end(signal.SIGKILL) == -signal.SIGKILL
    assert len(read_messages(tmp_path / "ended.mcap")["/vehicle"]) == 2
    assert (len(drive.speeds()), drive.pictures()) == (2, 3)


def test_a_real_recording(recordings: Path, tmp_path: Path) -> None:
    """Its rows first, then its pictures in any order, as the simulator writes them."""
    source = recordings / "lake_windows"
    lines = (source / "driving_log.csv").read_text().splitlines(keepends=True)[:200]
    drive = Drive(tmp_path / "drive")
    names = sorted(
        name.strip().split("\\")[-1] for line in lines for name in line.split(",")[:3]
    )  # centre, left, right

    def steps() -> None:
        for start in range(0, 200, 50):
            drive.append("".join(lines[start : start + 50]))
        drive.wait_until(lambda: len(drive.speeds()) == 200)
        (drive.folder / "IMG").mkdir()
        for name in names:
            shutil.copyfile(source / "IMG" / name, drive.folder / "IMG" / name)
        drive.wait_until(lambda: drive.pictures() == 600)

    done = watch(drive, tmp_path / "watched.mcap", steps)
    assert (done.rows, done.pictures, len(done.skipped)) == (200, 600, 0)
    assert contents(done.path) == contents(import_udacity(drive.folder, tmp_path / "imported.mcap").path)


def test_what_was_watched_is_kept_and_named_on_a_full_disk(tmp_path: Path) -> None:
    make_recording(tmp_path / "drive", "".join(f"{paths(number)},0,1,0,9.5\n" for number in range(3)))
    with files_of_at_most(2_000), pytest.raises(UserError, match=r"bc-log recover .*\.part"):
        watch_udacity(tmp_path / "drive", tmp_path / "log.mcap", idle_s=0)
    [part] = tmp_path.glob("log.mcap.*.part")
    assert sorted(tmp_path.iterdir()) == [tmp_path / "drive", part]
