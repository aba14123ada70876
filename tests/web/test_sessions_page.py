"""The list of sessions shows what the commands know of each log, also of those that are unfinished or damaged."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlencode

import cv2
import numpy as np
import pytest

import dataset.cli
import recorder.log_cli
from common.car import Camera
from dataset.config import IndexConfig
from dataset.index.build import build_index
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from tests.helpers.driving import road_jpeg
from tests.helpers.logs import START_NS, write_log
from tests.helpers.pages import open_session, opened_page, window_of, with_token
from tests.helpers.ports import free_ports
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, plain, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

AWKWARD = "<b>a & \"b\" 'c' 100%?#é\n;"


def road(camera: Camera, row: int) -> bytes:
    return road_jpeg(row)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """One session of each kind: in the index, with tags, standing still, unfinished, damaged, oddly named."""
    folder = tmp_path_factory.mktemp("bench")
    sessions = folder / "sessions"
    turning = [0.05 * (row % 9 - 4) for row in range(400)]
    plain = write_log(sessions / "plain.mcap", turning, road)
    write_log(sessions / "stuck.mcap", [0.3] * 50, start_ns=START_NS + 10**12, cameras=["center"])
    write_log(sessions / f"{AWKWARD}.mcap", turning[:20], source="<i>evil</i>")
    whole = plain.read_bytes()
    (sessions / "killed.mcap.0a1b2c.part").write_bytes(whole[: len(whole) // 2])
    (sessions / "nothing.mcap").write_bytes(b"not a log")
    (sessions / "notes.txt").write_text("no log")
    assert call(recorder.log_cli.main, "tag", plain, "exclude", "--rows", 3, 12) == 0
    assert call(recorder.log_cli.main, "tag", plain, "exclude", "--rows", 10, 19) == 0
    assert call(dataset.cli.main, "plain", "--sessions", sessions, "--index", folder / "index") == 0
    with served(folder) as server:
        wait_until(lambda: "being read" not in server.get("/sessions").text)
        yield server


def rows(bench: Served, **query: str) -> dict[str, str]:
    """The text of each session in the list, by name and in the order of the list."""
    page = bench.get(f"/sessions?{urlencode(query)}").text
    items = re.findall(r"<li .*?</li>", page, re.DOTALL)
    names = [html.unescape(re.findall(r'class="name"[^>]*>(.*?)</a>', item, re.DOTALL)[0]) for item in items]
    return dict(zip(names, map(plain, items), strict=True))


def test_each_session_is_reported_as_the_commands_tell_it(
    bench: Served, capsys: pytest.CaptureFixture[str]
) -> None:
    listed = rows(bench)
    shown = AWKWARD.replace("\n", "\\n")
    assert set(listed) == {"plain", "stuck", shown, "killed.mcap.0a1b2c.part", "nothing"}
    assert "0:40 min 400 rows" in listed["plain"]
    assert "exclude 17" in listed["plain"]  # rows 3 to 19, some of them twice
    assert "in the index" in listed["plain"]
    assert "left out by choice" in listed[shown]
    assert "stuck steering 50" in listed["stuck"]
    assert "unfinished" in listed["killed.mcap.0a1b2c.part"]
    assert "bc-log recover" in listed["killed.mcap.0a1b2c.part"]
    assert "damaged" in listed["nothing"]
    assert "MCAP" in listed["nothing"]


def test_names_and_sources_are_text(bench: Served) -> None:
    page = bench.get("/sessions").text
    assert "<b>a" not in page
    assert "<i>evil" not in page
    assert "&lt;i&gt;evil" in page


def test_sorted_searched_and_filtered(bench: Served) -> None:
    assert next(iter(rows(bench))) == "stuck"  # the newest
    assert next(iter(rows(bench, sort="rows"))) == "plain"
    assert next(iter(rows(bench, sort="most odd rows"))) == "stuck"
    assert list(rows(bench, text="PLA")) == ["plain"]
    assert list(rows(bench, text="exclude")) == ["plain"]
    assert set(rows(bench, only="unfinished or damaged")) == {"killed.mcap.0a1b2c.part", "nothing"}
    assert len(rows(bench, sort="no such", only="no such")) == 5


def test_the_condition_of_bc_index_finds_rows(bench: Served) -> None:
    where = "steering > 0.25 and row < 20"
    wait_until(lambda: "4 logs searched" in bench.get(f"/sessions?{urlencode({'where': where})}").text)
    listed = rows(bench, where=where)
    assert list(listed) == ["stuck"]
    assert "20 rows where" in listed["stuck"]


@pytest.mark.parametrize(
    ("where", "problem"),
    [
        ("no_such_column > 1", "no column no_such_column"),
        ("1; drop table x", "expected comparisons such as speed_mph"),
        ("len(repeat('x', 1500000000)) > 0", "expected a column, number, quoted text"),
        ("(" * 3000, "at most 2,000 are allowed"),
        ("<b>", "columns are session, row, camera"),
    ],
)
def test_what_is_no_condition_is_a_line_on_the_page(bench: Served, where: str, problem: str) -> None:
    page = bench.get(f"/sessions?{urlencode({'where': where})}").text
    assert 'role="alert"' in page
    assert problem in page
    answer = bench.get(f"/sessions.found?{urlencode({'where': where})}")
    assert (answer.status, problem in answer.text) == (422, True)


def test_the_film_strip_shows_the_sessions_pictures(bench: Served) -> None:
    """Four of them, from its beginning to its end."""
    answer = bench.get("/sessions/plain/strip.jpg")
    assert answer.headers["content-type"] == "image/jpeg"
    strip = decoded(answer.body)
    assert strip.shape == (80, 640, 3)
    for number in range(4):
        whole = decoded(road_jpeg(50 + 100 * number))
        small = cv2.resize(whole, (160, 80), interpolation=cv2.INTER_AREA).astype(float)
        assert np.abs(strip[:, 160 * number : 160 * number + 160] - small).mean() < 8


@pytest.mark.parametrize("bins", [None, 101])
def test_the_sketch_has_the_bins_of_the_index(tmp_path: Path, bins: int | None) -> None:
    log = write_log(tmp_path / "sessions" / "a.mcap", np.linspace(-1, 1, 500).tolist(), cameras=["center"])
    if bins is not None:
        build_index([log], tmp_path / "index", IndexConfig(bins=bins))
    with served(tmp_path) as bench:
        wait_until(lambda: "steering.svg" in bench.get("/sessions").text)
        (address,) = re.findall(r'src="(/sessions/a/steering.svg[^"]*)"', bench.get("/sessions").text)
        answer = bench.get(html.unescape(address))
    assert answer.headers["content-type"] == "image/svg+xml"
    assert answer.body.startswith(b"<svg ")
    assert len(re.findall(r"v-[\d.]+h", answer.text)) == (bins or 25)


def test_what_commands_change_appears(tmp_path: Path) -> None:
    with served(tmp_path) as bench:
        assert "Import a recording" in bench.get("/sessions").text  # how to begin
        before = bench.get("/changes").json
        log = write_log(tmp_path / "sessions" / "a.mcap", [0.1, 0.2])
        after = wait_until(lambda: (changes := bench.get("/changes").json) != before and changes)
        assert list(wait_until(lambda: rows(bench))) == ["a"]
        call(recorder.log_cli.main, "tag", log, "good", "--rows", 0, 1)
        wait_until(lambda: bench.get("/changes").json != after)
        wait_until(lambda: "good 2" in rows(bench)["a"])
        tags = log.with_name("a.tags.jsonl")
        tags.write_text(tags.read_text() + "no tag\n")
        assert "line 2 is not a tag" in rows(bench)["a"]
        write_log(tmp_path / "b.mcap", [0.1] * 7).replace(log)
        wait_until(lambda: "7 rows" in rows(bench)["a"])
        log.unlink()
        assert rows(bench) == {}


def decoded(data: bytes) -> np.ndarray:
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return picture


def test_a_recording_is_one_from_its_first_moment(tmp_path: Path) -> None:
    """Before its first second is on the disk it is no log yet, but not damaged."""
    with LogWriter(tmp_path / "sessions" / "new.mcap", {}):
        (part,) = (tmp_path / "sessions").iterdir()
        write_log(tmp_path / "sessions" / "read_after_it.mcap", [0.1] * 3)
        with served(tmp_path) as bench:
            wait_until(lambda: "3 rows" in rows(bench)["read_after_it"])
            rows_found = rows(bench)[part.name]
            assert "recording" in rows_found
            assert "damaged" not in rows_found
            assert "not an MCAP log" not in rows_found
            assert part.stat().st_size == 0


def test_a_recording_that_grows_need_not_be_recovered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recorder.log.writer.FLUSH_S", 0)
    with LogWriter(tmp_path / "sessions" / "new.mcap", {}, live=True) as writer:
        for row in range(30):
            writer.vehicle(START_NS + row * 10**8, row, VehicleState(speed_mph=9.0))
        (part,) = (tmp_path / "sessions").iterdir()
        with served(tmp_path) as bench:
            wait_until(lambda: "30 rows" in rows(bench)[part.name])
            assert "recording" in rows(bench)[part.name]
            assert "recover" not in rows(bench)[part.name]


def test_the_list_keeps_up_without_a_reload(browser: Browser, tmp_path: Path) -> None:
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/sessions") as page:
        page.wait_for_selector("text=No recordings yet")
        for name in ("lake", "mountain"):
            write_log(tmp_path / "sessions" / f"{name}.mcap", [0.1] * 20, lambda camera, row: road_jpeg(row))
        page.wait_for_selector("#s-lake img")
        page.wait_for_selector("#s-mountain img")
        wait_until(lambda: page.evaluate("[...document.images].every(image => image.naturalWidth > 0)"))
        assert call(recorder.log_cli.main, "tag", tmp_path / "sessions" / "lake.mcap", "wet", "--start", 0) == 0
        page.wait_for_selector("#s-lake .tag")
        assert page.inner_text("#s-lake .tag") == "wet 20"
        page.fill("input[name=text]", "wet")
        page.wait_for_selector("#s-mountain", state="detached")
        assert page.url == f"{bench.address}/sessions?text=wet&sort=newest&only=all"
        page.click("text=lake")
        open_session(page)
        page.go_back()
        page.wait_for_selector("#s-lake")
        assert page.input_value("input[name=text]") == "wet"
        assert page.locator("#s-mountain").count() == 0


def test_a_search_typed_during_a_restart_is_answered(browser: Browser, tmp_path: Path) -> None:
    for name in ("lake", "mountain"):
        write_log(tmp_path / "sessions" / f"{name}.mcap", [0.1] * 20, lambda camera, row: road_jpeg(row))
    (port,) = free_ports(1)
    with window_of(browser, 1280, 800) as page:
        with served(tmp_path, port=port) as bench:
            page.goto(with_token(f"{bench.address}/sessions"))
            page.wait_for_selector("#s-mountain")
        page.wait_for_selector("#status:text('bc-web does not answer')")
        with page.expect_event("requestfailed", lambda request: "/sessions?" in request.url):
            page.fill("input[name=text]", "lake")
        with served(tmp_path, port=port):
            page.wait_for_selector("#s-mountain", state="detached")
            assert page.is_visible("#s-lake")
