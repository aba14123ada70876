"""New logs of a log, from its page: the command that is shown makes them, as a job, and nothing is overwritten."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlencode

import pytest

import recorder.log_cli
from recorder import Log, LogWriter
from recorder.bc_pb2 import VehicleState
from tests.helpers.logs import START_NS, write_log
from tests.helpers.pages import open_session, opened_page
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROWS = 20


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Served]:
    sessions = tmp_path / "sessions"
    sessions.mkdir()
    with LogWriter(sessions / "two.mcap", {"source": "test"}) as writer:  # drives, with a pause between
        for row in range(ROWS):
            time_ns = START_NS + row * 100_000_000 + (row >= 12) * 60_000_000_000
            writer.vehicle(time_ns, row, VehicleState(steering=row / 100, speed_mph=9.0))
    write_log(sessions / "other one.mcap", [0.3] * 7)
    with served(tmp_path) as server:
        yield server


def command(bench: Served, job: str, *values: tuple[str, str], log: str = "two") -> str:
    return bench.command(f"/sessions/{log}/make/{job}/command?{urlencode(values)}")


def rows(path: Path) -> list[int]:
    with Log(path) as log:
        return list(log.vehicle()["row"].to_pylist())


def key_of_other(bench: Served) -> str:
    option = re.search(r'<option value="([^"]*)">other one', bench.get("/sessions/two").text)
    assert option is not None
    return option[1]


def test_a_selected_stretch_becomes_a_log_that_the_job_links_to(browser: Browser, bench: Served) -> None:
    with opened_page(browser, f"{bench.address}/sessions/two#row=5") as page:
        open_session(page)
        page.keyboard.press("[")
        for _ in range(4):
            page.keyboard.press("ArrowRight")
        page.keyboard.press("]")
        page.click("#make summary")
        new = bench.folder / "sessions" / "two-trimmed.mcap"
        shown = f"bc-log trim {bench.folder}/sessions/two.mcap --rows 5 9 --to={new}"
        wait_until(lambda: page.text_content("#command-trim") == shown)
        page.fill("#make-trim [name=new]", "bend")
        wait_until(lambda: (page.text_content("#command-trim") or "").endswith("/bend.mcap"))
        page.click("#make-trim button")
        page.click("text=the result")
        open_session(page)
        assert page.inner_text("h1") == "bend"
    assert rows(bench.folder / "sessions" / "bend.mcap") == [5, 6, 7, 8, 9]
    assert rows(bench.folder / "sessions" / "two.mcap") == list(range(ROWS))


def test_the_commands_that_are_shown_do_it(bench: Served) -> None:
    sessions = bench.folder / "sessions"
    damaged = (sessions / "two.mcap").read_bytes()[:-200]
    (sessions / "torn.mcap").write_bytes(damaged)
    lines = [
        command(bench, "split"),
        command(bench, "merge", ("other", key_of_other(bench)), ("new", "both")),
        command(bench, "recover", log="torn"),
        command(bench, "check"),
    ]
    codes = [call(recorder.log_cli.main, *shlex.split(line)[1:]) for line in lines]
    assert codes[0] == codes[1] == 0
    assert rows(sessions / "two-1.mcap") + rows(sessions / "two-2.mcap") == list(range(ROWS))
    assert len(rows(sessions / "both.mcap")) == ROWS + 7
    assert rows(sessions / "torn.recovered.mcap") == list(range(ROWS))
    assert (sessions / "torn.mcap").read_bytes() == damaged
    for line, job in zip(lines, ("split", "merge", "recover"), strict=False):
        log = "torn" if job == "recover" else "two"
        asked = [("other", key_of_other(bench)), ("new", "both")] if job == "merge" else []
        assert "exists already" in command(bench, job, *asked, log=log), line


def test_what_cannot_be_done_is_reported_and_not_started(bench: Served) -> None:
    for job, values, why in (
        ("trim", {"first": "3", "last": "2"}, "the first row, then the last one"),
        ("trim", {"first": "x", "last": "2"}, "expected the number of a row"),
        ("trim", {"first": "0", "last": "2", "new": "../up"}, "expected the name of a log"),
        ("trim", {"first": "0", "last": "2", "new": "-f"}, "expected the name of a log"),
        ("trim", {"first": "0", "last": "2", "new": "ü" * 150}, "expected the name of a log"),  # 300 bytes
        ("trim", {"first": "0", "last": "2", "new": "other one"}, "exists already"),
        ("merge", {}, "choose at least one other log"),
        ("merge", {"other": "none"}, "no log 'none'"),
        ("rm", {}, "no job on a log has this name"),
    ):
        answer = bench.post(f"/sessions/two/make/{job}", **values)
        assert answer.status in (404, 409, 422)
        assert why in answer.json["error"]
    assert "Nothing has run yet" in bench.get("/jobs").text


def test_a_log_that_is_recorded_or_deleted_meanwhile_is_left_alone(bench: Served) -> None:
    sessions = bench.folder / "sessions"
    writer = LogWriter(sessions / "now.mcap", {"source": "test"})
    try:
        writer.vehicle(START_NS, 0, VehicleState(steering=0.0))
        part = next(sessions.glob("now.mcap.*.part"))
        assert "this log is being recorded" in command(bench, "recover", log=part.name)
    finally:
        writer.close()
    (sessions / "two.mcap").unlink()
    assert bench.post("/sessions/two/make/split").status == 404
