"""Many stretches at once in a real browser: selected by a filter, looked at, tagged, and undone as one."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from recorder import Log
from recorder.log.tags import read_tags
from tests.helpers.driving import road_jpeg
from tests.helpers.faulty_session import CRASH, GAP_AT, ROWS, STUCK, write_faulty
from tests.helpers.logs import write_log
from tests.helpers.pages import drag, open_session, opened_page, press, selected_rows
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Served]:
    for name in ("faulty", "other"):
        write_faulty(tmp_path / "sessions" / f"{name}.mcap")
    write_log(tmp_path / "sessions" / "good.mcap", [0.01 * (row % 40) for row in range(50)], road)
    with served(tmp_path) as server:
        wait_until(lambda: "being read" not in server.get("/sessions").text)
        yield server


def road(camera: str, row: int) -> bytes:
    return road_jpeg(row)


@contextlib.contextmanager
def opened(browser: Browser, bench: Served, at: str = "/sessions/faulty") -> Iterator[Page]:
    with opened_page(browser, f"{bench.address}{at}") as page:
        if at.startswith("/sessions/"):
            open_session(page)
        yield page


def tags(bench: Served, name: str = "faulty") -> list[tuple[str, int, int]]:
    log = bench.folder / "sessions" / f"{name}.mcap"
    with Log(log) as opened:
        return [(tag.name, tag.first_row, tag.last_row) for tag in read_tags(log, opened.fingerprint)]


def selected(page: Page) -> str:
    return page.inner_text("#selected")


def across(page: Page, row: int) -> tuple[float, float]:
    """The place of a row in the curves, all of which are shown."""
    box = page.locator("#curves .u-over").first.bounding_box()
    assert box is not None
    return box["x"] + box["width"] * row / (ROWS - 1), box["y"] + box["height"] / 2


def test_a_kind_is_selected_excluded_and_undone_as_one(browser: Browser, bench: Served) -> None:
    with opened(browser, bench) as page:
        page.click("#kinds [data-kind=crash]")
        assert selected(page) == f"rows {CRASH[0]} to {CRASH[1]} selected"
        assert page.locator("#odd li").count() == 1
        page.click("#kinds [data-kind=crash]")  # all of them again
        assert (selected(page), page.locator("#odd li").count()) == ("", 3)
        page.fill("#where", "row < 10 or row > 590 or speed_mph < 1")
        page.keyboard.press("Enter")
        wait_until(lambda: "59 rows in 3 stretches selected" in selected(page))
        press(page, "f", 3)
        assert tags(bench) == [("fine", 0, 9), ("fine", 300, 339), ("fine", 591, 599)]
        press(page, "u", 0)
        assert tags(bench) == []
        press(page, "r", 3)
        assert len((page.text_content("#commands") or "").splitlines()) == 9  # each stretch of each change
        journal = bench.folder / "sessions" / "faulty.tags.jsonl"
        assert len(journal.read_text().splitlines()) == 9


def test_the_selection_is_looked_at_as_pictures(browser: Browser, bench: Served) -> None:
    with opened(browser, bench) as page:
        page.keyboard.press("g")
        wait_until(lambda: "select stretches first" in page.inner_text("#status"))
        page.fill("#where", "row < 10 or row > 590 or speed_mph < 1")
        page.keyboard.press("Enter")
        wait_until(lambda: "3 stretches selected" in selected(page))
        page.keyboard.press("g")
        lines = page.locator("#looking li")
        assert lines.count() == 3
        assert "rows 300 to 339" in lines.nth(1).inner_text()
        first = lines.nth(1).locator("img").first
        wait_until(lambda: first.evaluate("image => image.complete && image.naturalWidth") == 32)
        assert first.get_attribute("title") == "row 300"
        assert page.is_hidden("figure[data-camera=center]")
        lines.nth(0).locator("input").press(" ")  # it stays, but is no longer among them
        wait_until(lambda: "2 stretches selected" in selected(page))
        lines.nth(2).locator("img").last.click()
        assert page.get_attribute("#curves", "aria-valuenow") == "599"
        press(page, "x", 2)
        assert tags(bench) == [("exclude", 300, 339), ("exclude", 591, 599)]
        page.keyboard.press("Escape")
        page.wait_for_selector("#looking", state="hidden")
        assert page.is_visible("figure[data-camera=center]")


def test_a_stretch_is_clicked_as_a_whole_and_its_edges_are_moved(browser: Browser, bench: Served) -> None:
    with opened(browser, bench) as page:
        page.mouse.click(*across(page, 120))
        assert selected_rows(page) == STUCK
        page.keyboard.down("Shift")
        page.mouse.click(*across(page, 320))
        page.keyboard.up("Shift")
        assert selected(page) == "100 rows in 2 stretches selected"
        page.mouse.click(*across(page, 200))  # nothing odd is there
        assert selected(page) == ""
        page.mouse.click(*across(page, 120))
        page.keyboard.press(",")
        page.keyboard.press(".")
        assert selected_rows(page) == (STUCK[0] - 10, STUCK[1] + 10)  # a second each way
        page.keyboard.press("<")
        page.keyboard.press(">")
        page.keyboard.press(">")
        assert selected_rows(page) == (STUCK[0], STUCK[1] - 10)
        edge = page.locator("#curves .u-over").first.locator(".edge").last
        box = edge.bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 50)
        page.mouse.down()
        page.mouse.move(*across(page, 200), steps=5)
        page.mouse.up()
        first, last = selected_rows(page)
        assert first == STUCK[0]
        assert last == pytest.approx(200, abs=2)
        press(page, "x", 1)
        assert tags(bench) == [("exclude", first, last)]


def test_a_selection_does_not_grow_into_another_drive(browser: Browser, bench: Served) -> None:
    with opened(browser, bench) as page:
        first, last = drag(page, GAP_AT - 20, GAP_AT - 5, ROWS)
        for _ in range(3):
            page.keyboard.press(".")
        assert selected_rows(page) == (first, GAP_AT - 1)
        page.keyboard.press("Home")
        page.keyboard.press("[")
        page.keyboard.press("Shift+ArrowRight")
        page.keyboard.press("]")
        page.keyboard.press(",")
        assert selected_rows(page) == (0, 10)
        for _ in range(3):
            page.keyboard.press(">")
        assert selected_rows(page) == (0, 0)  # a row is always left
        assert last < GAP_AT


def test_the_strip_stays_in_view_and_goes_to_a_moment(browser: Browser, bench: Served) -> None:
    with opened(browser, bench) as page:
        for name in ("first", "last"):
            page.evaluate(f"scrollTo(0, {'0' if name == 'first' else 'document.body.scrollHeight'})")
            box = page.locator("#overview").bounding_box()
            assert box is not None
            assert 0 < box["y"] < 800 - box["height"]
        page.evaluate("scrollTo(0, 0)")
        box = page.locator("#overview").bounding_box()
        assert box is not None
        y = box["y"] + box["height"] / 2
        page.mouse.move(box["x"] + box["width"] / 2, y)
        page.mouse.down()
        wait_until(lambda: int(page.get_attribute("#curves", "aria-valuenow") or 0) == pytest.approx(300, abs=4))
        page.mouse.move(box["x"] + box["width"] / 4, y, steps=5)
        page.mouse.up()
        wait_until(lambda: int(page.get_attribute("#curves", "aria-valuenow") or 0) == pytest.approx(150, abs=4))


def test_a_kind_is_excluded_in_all_sessions_and_undone_as_one(browser: Browser, bench: Served) -> None:
    with opened(browser, bench, "/sessions") as page:
        assert page.is_hidden("#bulk")
        page.select_option("[name=only]", "with crash")
        page.wait_for_selector("#s-good", state="detached")
        assert page.locator(".session").count() == 2
        page.click("#look-at")
        lines = page.locator("#looking li")
        wait_until(lambda: lines.count() == 2)
        assert f"other, rows {CRASH[0]} to {CRASH[1]}" in lines.nth(1).inner_text()
        image = lines.nth(1).locator("img").first
        wait_until(lambda: image.evaluate("image => image.complete && image.naturalWidth") == 32)
        lines.nth(1).locator("input").uncheck()
        page.click("#exclude")
        wait_until(lambda: tags(bench) == [("exclude", *CRASH)])
        assert tags(bench, "other") == []
        page.click("#exclude")  # what is left
        wait_until(lambda: tags(bench, "other") == [("exclude", *CRASH)])
        wait_until(lambda: "50 rows in 1 stretch of 1 recording" in page.inner_text("#status"))
        page.click("#undo")
        wait_until(lambda: tags(bench, "other") == [])
        page.click("#undo")
        wait_until(lambda: tags(bench) == [])
        page.click("#exclude")
        wait_until(lambda: tags(bench) == tags(bench, "other") == [("exclude", *CRASH)])
        wait_until(lambda: "100 rows in 2 stretches of 2 recordings" in page.inner_text("#status"))
        page.reload()
        page.click("#undo")
        wait_until(lambda: tags(bench) == tags(bench, "other") == [])


def test_a_session_leads_to_the_same_in_all_sessions_and_back(browser: Browser, bench: Served) -> None:
    with opened(browser, bench) as page:
        assert page.is_hidden("#everywhere")
        page.click("#kinds [data-kind=stuck_steering]")
        page.click("#everywhere")
        page.wait_for_selector("#bulk")
        assert page.input_value("[name=only]") == "with stuck steering"
        page.click("#s-faulty a.flag:has-text('crash')")
        open_session(page)
        assert selected_rows(page) == CRASH
        page.keyboard.press("Escape")
        page.fill("#where", "speed_mph < 1")
        page.keyboard.press("Enter")
        wait_until(lambda: "Rows where" in page.inner_text("#odd-title"))
        page.click("#everywhere")
        page.wait_for_selector("#bulk")
        page.fill("#bulk #name", "slow")
        page.keyboard.press("Enter")
        wait_until(lambda: tags(bench, "other") == [("slow", 300, 339)])
        assert tags(bench, "good") == []
