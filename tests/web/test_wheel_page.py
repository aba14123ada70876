"""The page Drive: the commands that it starts, the drives that run now, and what an ended one has left."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from recorder import Log, LogWriter
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.log.meant_gaps import MeantGap
from recorder.log.tags import Tag, tags_by_content
from recorder.log.writer import pose_message
from recorder.teleop.wheel import Wheel
from simulator.pose import Pose
from simulator.roads.track import load_track
from tests.helpers.driving import untrained_run
from tests.helpers.logs import write_log
from tests.helpers.runs import a_run
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, plain, served
from web.errors import WebError
from web.folders.project_folders import ProjectFolders, key_of
from web.jobs.wheels import new_drive, training


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    with served(tmp_path) as server:
        yield server


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({}, "bc-record me drive-1 --track=lake --rate=10 --speed=10 --no-page"),
        (
            {"name": "a", "track": "random", "seed": "7", "speed": "12.5", "rate": "20"},
            "bc-record me a --track=random:7 --rate=20 --speed=12.5 --no-page",
        ),
        ({"simulator": "any"}, "bc-record listen drive-1 --me --speed=10 --no-page"),
        (
            {"driver": "run", "run": "r", "track": "hairpins:3"},
            "bc-drive r --takeover=me --speed=10 --simulator=hairpins:3 --log=drives/test-drive-1.mcap --no-page",
        ),
        (
            {"driver": "run", "run": "r", "simulator": "any"},
            "bc-drive r --takeover=me --speed=10 --log=drives/test-drive-1.mcap --no-page",
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
    words, run = training("sessions", log, ProjectFolders())
    assert (shlex.join(words), run) == ("bc-train --name=net-mine --on mine", "net-mine")
    untrained_run(Path("runs") / "net-mine")
    assert training("sessions", log, ProjectFolders())[1] == "net-mine-2"


def test_the_name_of_a_run_or_session_never_becomes_a_flag(tmp_path: Path) -> None:
    """A flag may name code to run."""
    folders = ProjectFolders(tmp_path / "sessions", runs=tmp_path / "runs", drives=tmp_path / "drives")
    run = untrained_run(tmp_path / "runs" / "--network=evil:Net")
    log = write_log(tmp_path / "sessions" / "--network=evil:Net.mcap", [0.1])
    for make in (
        lambda: new_drive({"driver": "run", "run": key_of(run)}, folders),
        lambda: training("sessions", log, folders),
    ):
        with pytest.raises(WebError, match="would take it for a flag"):
            make()


def test_a_drive_is_listed_while_it_runs(bench: Served) -> None:
    with Wheel("<b>lake</b>", bench.folder / "sessions" / "a.mcap", {}) as wheel:
        page = bench.get("/wheel").text
        assert f'href="/wheel/{wheel.key}"' in page
        assert "&lt;b&gt;lake" in page
        drive = bench.get(f"/wheel/{wheel.key}")
        assert 'data-after="/wheel/after/sessions/a"' in drive.text
    assert wheel.key not in bench.get("/wheel.rows").text
    ended = bench.get(f"/wheel/{wheel.key}")
    assert (ended.status, ended.headers["location"]) == (303, "/wheel/after/sessions/a")


def test_a_drive_that_cannot_begin_reports_why(bench: Served) -> None:
    write_log(bench.folder / "sessions" / "taken.mcap", [0.1])
    begun = bench.post("/wheel", name="taken")
    assert begun.status == 303
    page = begun.headers["location"]
    wait_until(lambda: "has not begun" in bench.get(page).text)
    assert "taken.mcap" in bench.get(page).text


@pytest.mark.parametrize("driver", ["me", "run"])
def test_a_taken_name_leads_back_to_the_form_with_its_values(bench: Served, driver: str) -> None:
    """No page has the flag --force, which the command would advise."""
    a_run(bench.folder / "runs", "first")
    write_log(bench.folder / ("sessions" if driver == "me" else "drives") / "taken.mcap", [0.1])
    begun = bench.post("/wheel", name="taken", driver=driver, run="first", speed="23")
    form = bench.get(begun.headers["location"]).text
    assert "taken.mcap: exists already; give another name" in form
    assert 'name="speed" type="number" min="1" max="100" step="any" value="23"' in form
    assert "--force" not in form
    assert "exists already" not in bench.get("/wheel").text


@pytest.mark.parametrize(
    ("page", "values"), [("/wheel", {"name": "mine"}), ("/jobs", {"form": "record", "name": "mine", "laps": "99"})]
)
def test_of_two_recordings_of_one_name_only_one_starts(bench: Served, page: str, values: dict[str, str]) -> None:
    """The other would lose its name at its end."""
    with ThreadPoolExecutor() as at_once:
        answers = list(at_once.map(lambda _: bench.post(page, **values), range(2)))
    begun, refused = sorted(answers, key=lambda answer: answer.status)
    assert (begun.status, refused.status) == (303, 409)
    assert "give another name" in refused.text
    job = f"/jobs/{begun.headers['location'].rpartition('/')[2]}"
    wait_until(lambda: list((bench.folder / "sessions").glob("mine.mcap.*.part")))
    bench.post(f"{job}/stop")
    wait_until(lambda: "running" not in bench.get(job).text)


def test_after_a_drive_it_can_be_trained_on_and_driven_on_from(bench: Served) -> None:
    driven_log(bench.folder / "sessions" / "mine.mcap", 200)
    page = bench.get("/wheel/after/sessions/mine").text
    assert "2 rows" in page
    assert "Train on it" in page
    assert "Drive on from here" in page
    assert "Let it drive" not in page


def test_an_imported_session_can_be_trained_on_but_not_driven_on_from(bench: Served) -> None:
    write_log(bench.folder / "sessions" / "mine.mcap", [0.1] * 30)
    page = bench.get("/wheel/after/sessions/mine").text
    assert "Train on it" in page
    assert "Drive on from here" not in page


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
    assert (words[:6], run) == (["bc-train", "continue", "r", "--takeovers", str(log), "--name=r-2"], "r-2")
    assert words[-1] == "--recipe=people"


def driven_log(path: Path, point: int, **metadata: str) -> Path:
    """A drive of the lake that ended at that point of its centre line."""
    line = load_track("lake").line
    with LogWriter(path, {"track": "lake", **metadata}) as writer:
        for row, at in enumerate((0, point)):
            time_ns = 10**18 + row * 10**9
            x_m, y_m, z_m = line.points_m[at]
            writer.vehicle(time_ns, row, VehicleState(steering=0.1))
            pose = Pose(x_m, y_m, z_m, line.heading_rad[at])
            writer.pose(time_ns, row, pose_message(pose, time_ns))
        if metadata.get("driver") == "human":
            writer.add_metadata("bc.person", {"hold_mph": "17.5"})
    return path


def test_driving_on_begins_where_the_drive_ended_as_it_was_driven(bench: Served) -> None:
    driven_log(bench.folder / "sessions" / "mine.mcap", 200, **{"driver": "human", "drive.rate": "20"})
    page = bench.get("/wheel/after/sessions/mine").text
    asked = dict(re.findall(r'name="(\w+)" value="([^"]*)"', page.partition("Drive on from here")[0]))
    folders = ProjectFolders(bench.folder / "sessions", drives=bench.folder / "drives")
    step_m = load_track("lake").line.step_m
    expected = f"bc-record me mine-2 --track=lake --rate=20 --start={200 * step_m + 1.3:.1f} --speed=17.5"
    assert shlex.join(new_drive(asked, folders).words).startswith(expected)
    write_log(bench.folder / "drives" / "mine-2.mcap", [0.1])
    assert new_drive(asked, folders).key == "mine-3"


def test_a_supervised_drive_resumes_at_its_speed_another_at_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    untrained_run(Path("runs") / "r")
    driven_log(Path("drives") / "d-1.mcap", 100, set_speed_mph="12")
    values = {"driver": "run", "run": "r", "like": "drives/d-1"}
    on = new_drive({**values, "on": "1"}, ProjectFolders())
    again = new_drive(values, ProjectFolders())
    line = "bc-drive r --takeover=me --speed=12 --simulator=lake"
    assert shlex.join(on.words) == f"{line} --start=51.3 --log=drives/d-2.mcap --no-page"
    assert shlex.join(again.words) == f"{line} --log=drives/test-drive-1.mcap --no-page"


@pytest.mark.parametrize("like", ["drives/none", "runs/r", "/etc/passwd", "sessions/../a", "sessions"])
def test_going_on_from_what_is_not_there_is_refused(like: str, tmp_path: Path) -> None:
    with pytest.raises(WebError) as refused:
        new_drive({"like": like, "on": "1"}, ProjectFolders(tmp_path))
    assert refused.value.status == 404


def test_the_seconds_before_the_road_was_left_can_be_left_out(
    bench: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = bench.folder / "sessions" / "mine.mcap"
    with LogWriter(log, {"source": "simulator", "driver": "human"}) as writer:
        for row in range(100):
            left = MeantGap(2.0, "the car left the road and was put back on its line") if row in (2, 60) else None
            writer.vehicle(10**18 + row * 10**8, row, VehicleState(steering=0.1), left)
    assert "You left the road 2 times" in plain(bench.get("/wheel/after/sessions/mine").text)
    monkeypatch.chdir(bench.folder)
    answer = bench.post("/wheel/after/sessions/mine/train", leave_out="1")
    assert answer.status == 303
    with Log(log) as written:
        tagged = tags_by_content(log)[written.fingerprint]
    assert sorted(tagged) == [Tag(0, 1, "exclude"), Tag(29, 59, "exclude")]
    assert "You left the road" not in bench.get("/wheel/after/sessions/mine").text
    wait_until(lambda: "running" not in bench.get("/jobs.now").text)  # it has no pictures to learn from
