"""A session is looked at and cleaned in a real browser; what was done there is checked with the commands."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import dataset.cli
import recorder.log_cli
from dataset.samples.samples_format import not_learnt_in
from recorder import Log, LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log.tags import read_tags
from tests.helpers.driving import road_jpeg
from tests.helpers.faulty_session import CRASH, ROWS, STUCK, write_faulty
from tests.helpers.logs import START_NS, write_log
from tests.helpers.pages import drag, open_session, opened_page, press, window_of, with_token
from tests.helpers.panorama import pressed, views, write_drive
from tests.helpers.ports import free_ports
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, served
from web.server.templates import STATIC

if TYPE_CHECKING:
    from playwright.sync_api import APIResponse, Browser, Page, Route


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Served]:
    write_faulty(tmp_path / "sessions" / "faulty.mcap")
    with served(tmp_path) as server:
        yield server


@contextlib.contextmanager
def opened(browser: Browser, bench: Served, name: str = "faulty") -> Iterator[Page]:
    """The page of a session, with all of its data there."""
    with opened_page(browser, f"{bench.address}/sessions/{name}") as page:
        open_session(page)
        yield page


def tags(bench: Served) -> list[tuple[str, int, int]]:
    """As the commands read them."""
    log = bench.folder / "sessions" / "faulty.mcap"
    with Log(log) as opened:
        return [(tag.name, tag.first_row, tag.last_row) for tag in read_tags(log, opened.fingerprint)]


def test_a_stretch_is_excluded_by_dragging_and_undone_and_done_again(browser: Browser, bench: Served) -> None:
    with opened(browser, bench) as page:
        rows = drag(page, 200, 260, ROWS)
        assert list(rows) == pytest.approx([200, 260], abs=3)
        press(page, "x", 1)
        assert tags(bench) == [("exclude", *rows)]
        press(page, "u", 0)
        assert tags(bench) == []
        press(page, "r", 1)
        assert tags(bench) == [("exclude", *rows)]
        press(page, "Control+z", 0)
        press(page, "Control+y", 1)
        # a name of one's own, for the same rows
        page.keyboard.press("t")
        page.keyboard.type("recovery")
        press(page, "Enter", 2)
        assert tags(bench) == [("exclude", *rows), ("recovery", *rows)]


def test_what_was_done_can_be_undone_after_a_reload(browser: Browser, bench: Served) -> None:
    with opened(browser, bench) as page:
        drag(page, 200, 260, ROWS)
        press(page, "x", 1)
        page.reload()
        open_session(page)
        assert "bc-log tag" in (page.text_content("#commands") or "")
        press(page, "u", 0)
        assert tags(bench) == []


def test_looking_at_all_pictures_ends_with_what_it_found(browser: Browser, bench: Served) -> None:
    with opened(browser, bench) as page:
        page.click("#look")
        wait_until(lambda: "looked at all pictures: 1 more odd stretch" in page.inner_text("#status"))


def test_time_is_counted_as_driven_where_the_clock_goes_back(browser: Browser, bench: Served) -> None:
    with LogWriter(bench.folder / "sessions" / "back.mcap", {"source": "test"}) as writer:
        for row in range(100):
            time_ns = START_NS + row * 100_000_000 - (3600 * 10**9 if row >= 50 else 0)
            writer.vehicle(time_ns, row, VehicleState(steering=0.1 * np.sin(row), throttle=0.5, speed_mph=9.0))
    with opened(browser, bench, "back") as page:
        page.keyboard.press("End")
        wait_until(lambda: now(page) == 99)
        assert "· 0:09.8 ·" in page.inner_text("#now")  # two drives of 4.9 s
        ticks = page.evaluate(
            """async () => {
              const { Curves } = await import('STATIC/js/session/curves.js');
              const driven_s = Float64Array.from({ length: 600 }, (_, at) => at * 0.11);
              const of = { data: { length: 600, columns: { driven_s } }, clamped: at => at };
              const at = Curves.prototype.roundTimes.call(of, 0, 599, 6);
              return at.map(each => Curves.prototype.roundTime.call(of, each));
            }""".replace("STATIC", STATIC)
        )
        assert ticks == ["0:00", "0:15", "0:30", "0:45", "1:00"]


def test_the_commands_that_are_shown_do_the_same(browser: Browser, bench: Served) -> None:
    with opened(browser, bench) as page:
        drag(page, 20, 60, ROWS)
        press(page, "x", 1)
        drag(page, 500, 550, ROWS)
        press(page, "x", 2)
        press(page, "u", 1)
        after = tags(bench)
        # the tags may be shown before that: the page asks for them every two seconds, too
        wait_until(lambda: len(page.inner_text("#commands").splitlines()) == 3)
        lines = page.inner_text("#commands").splitlines()
        (bench.folder / "sessions" / "faulty.tags.jsonl").unlink()
        for line in lines:
            words = line.split()
            assert words[0] == "bc-log"
            assert call(recorder.log_cli.main, *words[1:]) == 0
        assert tags(bench) == after


def test_all_that_is_sure_and_what_a_condition_finds_are_excluded_at_once(browser: Browser, bench: Served) -> None:
    with opened(browser, bench) as page:
        page.click("#exclude-odd")
        wait_until(lambda: tags(bench) == [("exclude", *CRASH)])  # the others a person has to look at
        wait_until(lambda: page.is_disabled("#exclude-odd"))
        page.fill("#where", "row < 3 or row >= 598")
        page.keyboard.press("Enter")
        wait_until(lambda: "5 rows in 2 stretches selected" in page.inner_text("#status"))
        assert len(tags(bench)) == 1  # they are selected first
        assert page.locator("#odd li").count() == 2
        page.keyboard.press("x")  # the keys are the page's again
        wait_until(lambda: tags(bench) == [("exclude", 0, 2), ("exclude", *CRASH), ("exclude", 598, 599)])
        page.click("#undo")
        wait_until(lambda: tags(bench) == [("exclude", *CRASH)])  # both at once
        page.fill("#where", "row > 600")
        page.press("#where", "Enter")
        wait_until(lambda: page.inner_text("#status") == "this log has no such rows")
        page.fill("#where", "speed")
        page.keyboard.press("Enter")
        wait_until(lambda: "no column speed (did you mean speed_mph?)" in page.inner_text("#status"))
        page.click("#where-clear")
        wait_until(lambda: page.locator("#odd li").count() == 3)


def test_j_passes_over_what_was_seen_and_is_fine(browser: Browser, bench: Served) -> None:
    with opened(browser, bench) as page:
        page.keyboard.press("j")
        wait_until(lambda: " of 3" in page.inner_text("#status"))
        message, below = (page.locator(part).bounding_box() for part in ("#status", "main"))
        assert message is not None
        assert below is not None
        assert message["y"] + message["height"] <= below["y"]  # what is said covers nothing
        press(page, "f", 1)
        assert tags(bench) == [("fine", *STUCK)]
        page.click("#exclude-odd")
        wait_until(lambda: tags(bench)[1:] == [("exclude", *CRASH)])
        page.keyboard.press("j")
        wait_until(lambda: "gap; 1 of 3" in page.inner_text("#status"))
        press(page, "u", 1)
        page.keyboard.press("k")
        wait_until(lambda: "1 of 3" not in page.inner_text("#status"))


def test_the_pictures_follow_the_mouse_and_the_keys(browser: Browser, bench: Served) -> None:
    with opened(browser, bench) as page:
        box = page.locator("#curves .u-over").first.bounding_box()
        assert box is not None
        for share in (0.25, 0.5, 0.75):
            page.mouse.move(box["x"] + share * box["width"], box["y"] + 30)
            assert_shown(page, round(share * (ROWS - 1)), within=2)
        at = now(page)
        page.keyboard.press("ArrowRight")
        assert_shown(page, at + 1)
        page.keyboard.press("Shift+ArrowLeft")
        assert_shown(page, at - 9)
        page.keyboard.press("Home")
        assert_shown(page, 0)
        page.keyboard.press(" ")  # for a minute, as it was driven
        wait_until(lambda: now(page) > 5)
        page.keyboard.press(" ")
        assert page.get_attribute("#play", "aria-pressed") == "false"
        assert now(page) < ROWS - 1
        page.evaluate("location.hash = 'row=560'")
        assert_shown(page, 560)
        page.keyboard.press("4")  # at 8 times the speed, half a second to its end
        page.keyboard.press(" ")
        wait_until(lambda: now(page) == ROWS - 1)
        wait_until(lambda: page.get_attribute("#play", "aria-pressed") == "false")
        page.evaluate("location.hash = 'row=450'")  # a link to another row of the page that is open
        assert_shown(page, 450)


def now(page: Page) -> int:
    return int(page.get_attribute("#curves", "aria-valuenow") or 0)


def pictures(page: Page) -> dict[str, int]:
    """The row of which each camera that is seen shows its picture."""
    shown = page.eval_on_selector_all(
        "figure:not([hidden])", "figures => figures.map(figure => figure.dataset.shown ?? '')"
    )
    return {name: int(row) for address in shown for name, row in re.findall(r"pictures/(\w+)/(\d+)", address)}


def assert_shown(page: Page, row: int, within: int = 0) -> None:
    """Both cameras show the picture of that row, by its brightness."""
    wait_until(lambda: set(pictures(page)) == {"center", "left"})
    wait_until(lambda: all(abs(at - row) <= within for at in pictures(page).values()))
    shown = page.evaluate(
        """() => [...document.querySelectorAll('figure:not([hidden]) > img:first-child')].map(image => {
            const canvas = document.createElement('canvas');
            const context = canvas.getContext('2d');
            context.drawImage(image, 0, 0);
            return context.getImageData(3, 3, 1, 1).data[0];
        })"""
    )
    assert shown == [pytest.approx(row * 255 // ROWS, abs=within + 1)] * 2


def test_an_answer_that_was_overtaken_by_a_newer_one_is_not_shown(browser: Browser, bench: Served) -> None:
    log = bench.folder / "sessions" / "faulty.mcap"
    held: list[tuple[Route, APIResponse]] = []
    with opened(browser, bench) as page:
        drag(page, 200, 260, ROWS)
        page.route("**/tags", lambda route: held.append((route, route.fetch())), times=1)
        assert call(recorder.log_cli.main, "tag", log, "good", "--rows", 5, 9) == 0
        wait_until(lambda: page.evaluate("1") and held)  # the page has asked by itself
        press(page, "x", 2)
        ((route, answer),) = held
        with page.expect_event("requestfinished", lambda request: request.url.endswith("/tags")):
            route.fulfill(response=answer)
        page.evaluate("new Promise(heard => setTimeout(heard, 100))")
        assert page.get_attribute("#session", "data-tags") == "2"


def test_what_commands_do_meanwhile_is_seen(browser: Browser, bench: Served) -> None:
    log = bench.folder / "sessions" / "faulty.mcap"
    with opened(browser, bench) as page:
        assert call(recorder.log_cli.main, "tag", log, "good", "--rows", 5, 9) == 0
        page.wait_for_selector("#session[data-tags='1']")
        journal = log.with_name("faulty.tags.jsonl")
        journal.write_text(journal.read_text() + "{}\n")
        wait_until(lambda: "line 2 is not a tag" in page.inner_text("#problem"))
        journal.unlink()
        page.wait_for_selector("#problem", state="hidden")
        with LogWriter(bench.folder / "new.mcap", {"source": "test"}) as writer:
            writer.vehicle(START_NS, 0, VehicleState(steering=0.0))
        (bench.folder / "new.mcap").replace(log)
        wait_until(lambda: "replaced" in page.inner_text("#problem"))
        log.unlink()
        wait_until(lambda: "deleted" in page.inner_text("#problem"))


def test_what_was_wrong_meanwhile_is_no_longer_said(browser: Browser, tmp_path: Path) -> None:
    log = write_log(tmp_path / "sessions" / "a.mcap", [0.1] * 20, lambda camera, row: road_jpeg(row))
    (port,) = free_ports(1)
    with window_of(browser, 1280, 800) as page:
        with served(tmp_path, port=port) as bench:
            page.goto(with_token(f"{bench.address}/sessions/a"))
            open_session(page)
            log.rename(tmp_path / "a.mcap")
            page.wait_for_selector("#problem:text('deleted')")
            (tmp_path / "a.mcap").rename(log)
            page.wait_for_selector("#problem", state="hidden")
        page.wait_for_selector("#problem:text('bc-web does not answer')")
        page.keyboard.press("[")
        page.keyboard.press("x")
        page.wait_for_selector("#status:text('bc-web does not answer')")
        with served(tmp_path, port=port):
            page.wait_for_selector("#problem", state="hidden")
            press(page, "x", 1)


def test_a_lag_that_is_measured_meanwhile_is_shown(browser: Browser, bench: Served) -> None:
    def late(at_s: np.ndarray) -> np.ndarray:
        return pressed(at_s - 0.3)

    log = write_drive(bench.folder / "sessions" / "late.mcap", views(1300), late)
    with opened(browser, bench, "late") as page:
        page.click("text=About this log")
        assert "lag not measured" in page.inner_text("#about")
        assert call(recorder.log_cli.main, "check", log) == 0
        wait_until(lambda: "0.4 s late" in page.inner_text("#about"))


PARTS = [(200, 24.0, 0.0), (10, 0.2, 0.0), (20, 3.0, 1.0), (10, 6.0, -0.4), (10, 12.0, -1.0), (200, 24.0, 0.0)]
"""Rows at a speed in mph with a steering: a car that hits a wall, manoeuvres, and drives on."""

HATCHED = """(rows) => {
  const canvas = document.querySelector('#curves canvas');
  const over = document.querySelector('#curves .u-over').getBoundingClientRect();
  const left = over.left - canvas.getBoundingClientRect().left;
  const scale = canvas.width / canvas.getBoundingClientRect().width;
  const y = Math.round((over.top - canvas.getBoundingClientRect().top + over.height * 0.15) * scale);
  const [from, to] = rows.map(row => Math.round((left + over.width * row / 449) * scale));
  const data = canvas.getContext('2d').getImageData(from, y, to - from, 1).data;
  const colors = Array.from({length: to - from}, (_, at) => data.slice(4 * at, 4 * at + 4).join());
  return colors.filter((color, at) => at && color !== colors[at - 1]).length > 8;
}"""
"""Whether the colour changes often between two rows, above the curves: more often than at lines of the grid."""


def test_what_training_leaves_out_is_hatched(browser: Browser, tmp_path: Path) -> None:
    with LogWriter(tmp_path / "sessions" / "a.mcap", {"source": "test"}) as writer:
        rows = [(mph, steering) for count, mph, steering in PARTS for _ in range(count)]
        for row, (mph, steering) in enumerate(rows):
            now_ns = START_NS + row * 100_000_000
            writer.picture("center", now_ns, row, road_jpeg(row))
            state = VehicleState(steering=steering, throttle=0.5, brake=0.0, speed_mph=mph)
            writer.vehicle(now_ns, row, state)
    index = tmp_path / "index"
    assert call(dataset.cli.main, "--sessions", tmp_path / "sessions", "--index", index) == 0
    (line,) = not_learnt_in(index)
    assert "a (40 frames of crashes, 20 frames of manoeuvres around these)" in line
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/sessions/a") as page:
        open_session(page)
        assert page.inner_text("#not-learnt") == "hatched: 60 rows that training leaves out by default"
        assert page.evaluate(HATCHED, [205, 235])
        assert not page.evaluate(HATCHED, [300, 330])
