"""Forms keep what is typed, start one command, and say what is wrong."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

from tests.helpers.driving import road_jpeg
from tests.helpers.logs import write_log
from tests.helpers.pages import open_session, opened_page
from tests.helpers.runs import a_run
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Route


def test_a_double_click_starts_one_job(browser: Browser, tmp_path: Path) -> None:
    twice = """() => {
      const button = document.querySelector("details[open] button.main");
      for (const at of [0, 50]) setTimeout(() => button.click(), at); // no answer comes in 50 ms
    }"""
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/jobs?start=train") as page:
        page.evaluate(twice)
        page.wait_for_url("**/jobs/*")
        assert bench.get("/jobs").text.count("<li id=") == 1
        page.go_back()
        page.click("details[open] button.main")  # once more, on purpose
        wait_until(lambda: bench.get("/jobs").text.count("<li id=") == 2)


def test_values_are_still_there_on_the_way_back_from_an_error(browser: Browser, tmp_path: Path) -> None:
    typed = {"name": "first", "epochs": "3", "on": "-x lake"}
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/jobs?start=train") as page:
        for name, value in typed.items():
            page.fill(f"#form-train [name={name}]", value)
        page.click("#form-train button.main")
        page.wait_for_selector("text=begins with a hyphen")
        page.go_back()
        wait_until(lambda: typed == {name: page.input_value(f"#form-train [name={name}]") for name in typed})
        page.goto(f"{bench.address}/import")
        page.fill("[name=source]", "/no/such folder")
        page.click("button:text('Open')")
        page.wait_for_selector("text=no such folder or file")
        page.go_back()
        wait_until(lambda: page.input_value("[name=source]") == "/no/such folder")


def test_rows_to_trim_are_still_there_after_an_error(browser: Browser, tmp_path: Path) -> None:
    write_log(tmp_path / "sessions" / "a.mcap", [0.1] * 20, lambda camera, row: road_jpeg(row))
    typed = {"first": "9", "last": "5", "new": "bend"}
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/sessions/a") as page:
        open_session(page)
        page.click("#make summary")
        for name, value in typed.items():
            page.fill(f"#make-trim [name={name}]", value)
        page.click("#make-trim button")
        page.wait_for_selector("h1:text('Unprocessable Entity')")
        page.go_back()
        open_session(page)
        page.wait_for_selector("#command-trim >> text=rows 9 to 5")  # unfolded, as it was
        assert typed == {name: page.input_value(f"#make-trim [name={name}]") for name in typed}
        page.keyboard.press("[")
        assert page.input_value("#make-trim [name=first]") == "0"  # selected rows replace them


def answer_slowly(route: Route) -> None:
    time.sleep(0.5)
    route.fulfill()


def test_a_form_with_values_shows_the_whole_command(browser: Browser, tmp_path: Path) -> None:
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/jobs?start=train&epochs=3") as page:
        page.wait_for_selector("#command-train:has-text('--epochs=3')", state="attached")
        page.click("#of-train .more summary")
        page.fill("#form-train [name=dropout]", "0.3")
        page.fill("#form-train [name=on]", "-x")
        page.click("#form-train button.main")
        page.wait_for_selector("h1:text('Unprocessable Entity')")
        page.route("**/slow.png", answer_slowly)  # a browser restores the fields after it
        page.add_init_script(
            "document.addEventListener('DOMContentLoaded', () => (new Image().src = '/slow.png'))"
        )
        page.go_back()
        page.wait_for_selector("#command-train >> text=begins with a hyphen")
        assert page.is_visible("#form-train [name=dropout]")


def test_the_name_of_a_drive_reports_which_characters_it_may_have(browser: Browser, tmp_path: Path) -> None:
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/wheel") as page:
        page.fill("[name=name]", "Fahrt über Land")
        assert page.evaluate("document.querySelector('[name=name]').validity.patternMismatch")
        assert "letters from a to z, digits" in (page.get_attribute("[name=name]", "title") or "")


def test_the_page_of_a_run_that_is_deleted_reports_so(browser: Browser, tmp_path: Path) -> None:
    run = a_run(tmp_path / "runs", "mine")
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/runs/mine") as page:
        run.rename(tmp_path / "elsewhere")
        wait_until(lambda: "no run 'mine' in it" in page.inner_text("#status"))
