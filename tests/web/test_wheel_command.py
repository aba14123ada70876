"""The commands that drive, with the bc-web that they start: real processes, one of them killed."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from recorder import Log
from recorder.teleop.wheel import open_wheels
from recorder.upkeep.check import check
from recorder.upkeep.recover import recover
from tests.helpers.driving import Process, command, untrained_run
from tests.helpers.waiting import wait_until
from tests.helpers.wheel_page import WheelPage
from tests.helpers.workbench import Served

ADDRESS = r"http://127\.0\.0\.1:(\d+)(/wheel/\S+)\?token=(\S+)"


@pytest.fixture(autouse=True)
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)


def recording() -> Process:
    return Process(command("bc-record", "me", "mine", "--sessions", "my/logs"))


def get(process: Process, address: str = "") -> str:
    """The page whose address the command has printed, or another one there; "" if there is none."""
    printed = process.wait_for(ADDRESS)
    answer = Served(Path(), int(printed[1]), printed[3]).get(address or printed[2])
    return answer.text if answer.status == 200 else ""


def is_served(process: Process) -> bool:
    try:
        return bool(get(process))
    except OSError:
        return False


def child_of(process: Process) -> int:
    """The process of bc-web, which is the only one that the command has started."""
    pids = [int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit()]
    children = [pid for pid in pids if _parent(pid) == process.popen.pid]
    assert len(children) == 1
    return children[0]


def _parent(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    except OSError:  # it has ended
        return 0


def drive(page: WheelPage, rows: int) -> None:
    page.send("record")
    while page.frame().state["rows"] < rows:
        page.steer(0.0, hold_mph=5)


def test_the_page_of_a_supervised_drive_knows_its_log_and_its_run(tmp_path: Path) -> None:
    untrained_run(tmp_path / "my" / "runs" / "first")
    flags = ("--runs", "my/runs", "--drives", "my/drives", "--sessions", "my/logs", "--viewer", "off")
    with Process(command("bc-drive", "first", "--simulator", "lake", "--takeover", "me", *flags)) as process:
        page = get(process)
        with WheelPage(open_wheels(Path.cwd())[0]) as person:
            while person.frame().state["rows"] < 3:
                person.steer(0.0, 0.5)
            person.send("end")
            person.text("ended")
        process.wait_for("the page stays until Ctrl-C")
        after = page.partition('data-after="')[2].partition('"')[0]
        assert "Drive on from here" in get(process, after)  # the run is there
        assert process.end() == 0
        wait_until(lambda: not is_served(process))


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="finds the process of bc-web in /proc")
def test_a_killed_bc_web_leaves_the_drive_and_its_log_as_they_are() -> None:
    with recording() as process:
        assert 'data-after="/wheel/after/sessions/mine"' in get(process)
        printed = process.wait_for(ADDRESS)
        assert Served(Path(), int(printed[1]), token="").get(printed[2]).status == 401  # for other users
        with WheelPage(open_wheels(Path.cwd())[0]) as page:
            drive(page, 3)
            os.kill(child_of(process), signal.SIGKILL)
            wait_until(lambda: not is_served(process))
            drive(page, 8)
        assert process.end() == 0
    log = Path("my/logs/mine.mcap")
    with Log(log) as opened:
        assert len(opened.vehicle()["steering"]) >= 8
    assert not check(log).findings


def test_all_killed_at_once_leave_a_log_that_is_whole_to_its_last_second() -> None:
    with recording() as process:
        process.wait_for(ADDRESS)
        with WheelPage(open_wheels(Path.cwd())[0]) as page:
            drive(page, 25)
            rows = page.frame().state["rows"]
            process.end(signal.SIGKILL)
        wait_until(lambda: not is_served(process))  # it ends with the command
    (part,) = Path("my/logs").glob("*.part")
    recovered = recover(part, Path("my/logs/mine.mcap"))
    assert recovered.rows >= rows - 10  # a second of them
