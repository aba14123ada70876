"""The page Drive: the commands that it starts, the drives that run now, and what an ended one has left."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlencode

import pytest

from driving import untrained_run
from logs import write_log
from recorder import LogWriter
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.teleop.wheel import Wheel
from waiting import wait_until
from web.data.project_folders import ProjectFolders
from web.data.wheels import new_drive, training
from web.errors import WebError
from workbench import Answer, Served, served

FORM = {"Content_Type": "application/x-www-form-urlencoded"}


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    with served(tmp_path) as found:
        yield found


def post(bench: Served, path: str, **values: str) -> Answer:
    return bench.ask("POST", path, urlencode(values).encode(), **FORM)


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({}, "bc-record drive-1 --driver=me --track=lake --rate=10 --speed=10 --no-page"),
        (
            {"name": "a", "track": "random", "seed": "7", "speed": "12.5", "rate": "20"},
            "bc-record a --driver=me --track=random:7 --rate=20 --speed=12.5 --no-page",
        ),
        ({"simulator": "any"}, "bc-record drive-1 --driver=me --listen --speed=10 --no-page"),
        (
            {"driver": "run", "run": "r", "track": "hairpins:3"},
            "bc-drive r --takeover=me --speed=10 --simulator=hairpins:3 --log=drives/drive-1.mcap --no-page",
        ),
        (
            {"driver": "run", "run": "r", "simulator": "any"},
            "bc-drive r --takeover=me --speed=10 --log=drives/drive-1.mcap --no-page",
        ),
    ],
)
def test_the_form_makes_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, values: dict[str, str], line: str
) -> None:
    monkeypatch.chdir(tmp_path)
    untrained_run(Path("runs") / "r")
    assert shlex.join(new_drive(values, ProjectFolders()).words) == line


@pytest.mark.parametrize(
    "values",
    [
        {"name": "--force"},
        {"name": "a b"},
        {"name": "../a"},
        {"track": "moon"},
        {"track": "lake:3"},
        {"track": "random", "seed": "-1"},
        {"speed": "nan"},
        {"speed": "0"},
        {"rate": "7"},
        {"driver": "run", "run": "nobody"},
    ],
)
def test_what_cannot_be_driven_is_refused(values: dict[str, str]) -> None:
    with pytest.raises(WebError) as refused:
        new_drive(values, ProjectFolders())
    assert refused.value.status == 422


def test_a_new_drive_has_a_name_that_no_log_has(tmp_path: Path) -> None:
    folders = ProjectFolders(tmp_path / "sessions", drives=tmp_path / "drives")
    write_log(tmp_path / "sessions" / "drive-1.mcap", [0.1])
    write_log(tmp_path / "drives" / "drive-2.mcap", [0.1])
    assert new_drive({}, folders).key == "drive-3"


def test_training_on_a_session_makes_a_run_of_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    log = write_log(Path("sessions") / "mine.mcap", [0.1])
    assert training("sessions", log, ProjectFolders()) == (["bc-train", "--name=mine", "--on", "mine"], "mine")
    untrained_run(Path("runs") / "mine")
    assert training("sessions", log, ProjectFolders())[1] == "mine-2"


def test_a_drive_is_listed_while_it_runs(bench: Served) -> None:
    with Wheel("<b>lake</b>", bench.folder / "sessions" / "a.mcap", {}) as wheel:
        page = bench.get("/wheel").text
        assert f'href="/wheel/{wheel.key}"' in page
        assert "&lt;b&gt;lake" in page
        drive = bench.get(f"/wheel/{wheel.key}")
        assert 'data-after="/wheel/after/sessions/a"' in drive.text
    assert wheel.key not in bench.get("/wheel.rows").text
    assert bench.get(f"/wheel/{wheel.key}").status == 404


def test_a_drive_that_cannot_begin_says_why(bench: Served) -> None:
    write_log(bench.folder / "sessions" / "taken.mcap", [0.1])
    begun = post(bench, "/wheel", name="taken")
    assert begun.status == 303
    page = begun.headers["location"]
    wait_until(lambda: "has not begun" in bench.get(page).text)
    assert "taken.mcap" in bench.get(page).text


def test_after_a_drive_it_can_be_trained_on_and_driven_on_from(bench: Served) -> None:
    write_log(bench.folder / "sessions" / "mine.mcap", [0.1] * 30)
    page = bench.get("/wheel/after/sessions/mine").text
    assert "30 rows" in page
    assert "Train on it" in page
    assert "Drive on from here" in page
    assert "Let it drive" not in page


def test_after_a_supervised_drive_each_takeover_is_a_link_to_its_row(bench: Served) -> None:
    log = bench.folder / "drives" / "d.mcap"
    pilot, human = PilotCommand.PILOT, PilotCommand.HUMAN
    with LogWriter(log, {"run": "r", "track": "lake"}) as writer:
        for row, driver in enumerate([pilot, pilot, human, human, pilot, human]):
            time_ns = 10**18 + row * 10**9
            writer.vehicle(time_ns, row, VehicleState(steering=0.1))
            writer.command(time_ns, row, PilotCommand(steering=0.1, driver=driver))
    page = bench.get("/wheel/after/drives/d").text
    assert "2 times" in page
    assert [row for row in range(6) if f'href="/drives/d#row={row}"' in page] == [2, 5]
    assert "Learn from it" not in page  # the run that drove is not here
    untrained_run(bench.folder / "runs" / "r")
    assert "Learn from it" in bench.get("/wheel/after/drives/d").text
    words, run = training("drives", log, ProjectFolders(runs=bench.folder / "runs"))
    assert (words[:4], run) == (["bc-train", "--init=r", f"--takeovers={log}", "--name=r-2"], "r-2")


def test_a_drive_that_recorded_nothing_says_so(bench: Served) -> None:
    assert "Nothing was recorded" in bench.get("/wheel/after/sessions/no-such").text
    assert bench.get("/wheel/after/runs/no-such").status == 404
