"""What a page looks like: one primary action, a first screen that leads on, and a phone's width that is used."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Final

from tests.helpers.driving import road_jpeg, untrained_run
from tests.helpers.histories import epoch_line, write_lines
from tests.helpers.logs import write_log
from tests.helpers.pages import open_session, opened_page
from tests.helpers.runs import a_run
from tests.helpers.udacity import make_recording, paths
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PRIMARY: Final = {
    "/sessions": "Import a recording",
    "/import": "Choose a folder",
    "/import/lake": "Import",
    "/index": "Train on it",
    "/runs": "Train a network",
    "/runs/r": "Let it drive, and take over",
    "/drives": "Let a network drive",
    "/jobs?start=train": "Start",
    "/wheel": "Take the wheel",
}

SWAPPED: Final = """() => new Promise((done) => {
  document.addEventListener("htmx:after:swap", done, {once: true});
  document.getElementById("list").dispatchEvent(new CustomEvent("folders-changed"));
})"""
"""Let the list be replaced."""


def primary(page: Page) -> list[str]:
    return page.locator(".main:visible").all_inner_texts()


def test_each_page_has_one_primary_action(browser: Browser, tmp_path: Path) -> None:
    write_log(tmp_path / "sessions" / "a.mcap", [0.1] * 20, lambda camera, row: road_jpeg(row))
    make_recording(tmp_path / "recordings" / "lake", f"{paths(0)},0.1,0.5,0,9.5\n")
    run = untrained_run(tmp_path / "runs" / "r")
    config = json.loads((run / "config.json").read_text())
    config.update(training={"epochs": 2, "recipe": "original", "seed": 3}, data={})
    (run / "config.json").write_text(json.dumps(config))
    write_lines(run / "metrics.jsonl", [epoch_line(1), epoch_line(2)])
    with served(tmp_path) as bench, opened_page(browser, bench.address) as page:
        wait_until(lambda: "Let it drive" in bench.get("/runs/r").text)
        for path, action in PRIMARY.items():
            page.goto(f"{bench.address}{path}", wait_until="networkidle")
            assert primary(page) == [action], path
        page.goto(f"{bench.address}/runs/r")
        page.click("text=Train again")
        page.wait_for_selector("#form-train:visible")
        given = {
            name: page.input_value(f"#form-train [name={name}]")
            for name in ("network", "epochs", "recipe", "seed")
        }
        assert given == {"network": "small", "epochs": "2", "recipe": "original", "seed": "3"}


def test_an_open_run_page_names_a_log_that_is_deleted(browser: Browser, tmp_path: Path) -> None:
    log = write_log(tmp_path / "sessions" / "a.mcap", [0.1] * 20, lambda camera, row: road_jpeg(row))
    run = a_run(tmp_path / "runs", "mine")
    config = json.loads((run / "config.json").read_text()) | {"index": "index-mine", "data": {"logs": {"a": {}}}}
    (run / "config.json").write_text(json.dumps(config))
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/runs/mine") as page:
        page.wait_for_selector("text=Train again")
        notice = page.locator("text=Train again does not use the same data: a is not in these folders.")
        assert not notice.count()
        log.unlink()
        notice.wait_for()
        colours = [each.evaluate("each => getComputedStyle(each).color") for each in (notice, page.locator("h1"))]
        assert colours[0] == colours[1]  # it is no error


def test_the_first_screen_leads_to_all_that_can_be_done_first(browser: Browser, tmp_path: Path) -> None:
    with served(tmp_path) as bench, opened_page(browser, bench.address) as page:
        assert primary(page) == ["Take the wheel"]
        assert page.is_visible("text=watch the demo")
        for leads_to in ("/wheel", "/import"):
            page.click(f".hero a[href='{leads_to}']")
            page.wait_for_url(f"**{leads_to}")
            page.go_back()
        page.goto(f"{bench.address}/sessions")
        assert page.is_hidden("#filters")
        write_log(tmp_path / "sessions" / "a.mcap", [0.1] * 20, lambda camera, row: road_jpeg(row))
        page.wait_for_selector("#s-a")
        page.wait_for_selector("#filters")
        assert primary(page) == ["Import a recording"]


def test_a_session_uses_the_width_of_a_phone(browser: Browser, tmp_path: Path) -> None:
    write_log(
        tmp_path / "sessions" / "a.mcap",
        [0.1] * 20,
        lambda camera, row: road_jpeg(row),
        cameras=["center", "left", "right"],
    )
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/sessions/a", width=390) as page:
        open_session(page)
        page.wait_for_selector("[data-camera=center] img.enlarged")
        lists = [page.locator(f"section[aria-labelledby={name}-title]").bounding_box() for name in ("odd", "tags")]
        center = page.locator("[data-camera=center]").bounding_box()
        for box in (*lists, center):
            assert box is not None
            assert box["width"] > 350  # of 390
        assert lists[0] is not None
        assert lists[1] is not None
        assert lists[1]["y"] >= lists[0]["y"] + lists[0]["height"]  # one under the other


def test_a_command_stays_unfolded_while_the_list_changes(browser: Browser, tmp_path: Path) -> None:
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/jobs?start=record") as page:
        page.fill("details[open] [name=name]", "first lap")
        page.fill("details[open] [name=laps]", "none")
        page.click("details[open] button")
        page.click("text=Back to the form")
        page.goto(f"{bench.address}/jobs")
        page.click("#commands-shown")
        entry = page.locator(".jobs li").first
        assert entry.locator("a").inner_text() == "Record first lap"
        entry.locator("summary").click()
        page.evaluate(SWAPPED)
        assert entry.locator("details code").is_visible()
        assert "bc-record 'first lap' --laps=none" in entry.locator("details code").inner_text()


def test_runs_with_long_names_fit_on_a_phone(browser: Browser, tmp_path: Path) -> None:
    """A run that was not named has a name of 26 characters."""
    name = "2026-11-28_12-34-42-9dae8c"
    a_run(tmp_path / "runs", name)
    write_log(tmp_path / "sessions" / "a.mcap", [0.1] * 20, lambda camera, row: road_jpeg(row))
    paths = ("/map?of=sessions/a", "/sessions/a", f"/runs/{name}", "/runs", f"/wheel?driver=run&run={name}")
    with served(tmp_path) as bench, opened_page(browser, bench.address, width=390) as page:
        wait_until(lambda: "Let it drive" in bench.get(f"/runs/{name}").text)
        for path in paths:
            page.goto(f"{bench.address}{path}", wait_until="networkidle")
            assert page.evaluate("document.documentElement.scrollWidth") == 390, path
