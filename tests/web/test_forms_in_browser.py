"""Forms keep what is typed, and start one command."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pages import opened_page
from waiting import wait_until
from workbench import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser


def test_a_double_click_starts_one_job(browser: Browser, tmp_path: Path) -> None:
    twice = """() => {
      const button = document.querySelector("details[open] button.main");
      for (const at of [0, 50]) setTimeout(() => button.click(), at); // no answer comes in 50 ms
    }"""
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/jobs?start=train") as page:
        page.evaluate(twice)
        page.wait_for_url("**/jobs/*")
        assert bench.get("/jobs.rows").text.count("<li id=") == 1
        page.go_back()
        page.click("details[open] button.main")  # once more, on purpose
        wait_until(lambda: bench.get("/jobs.rows").text.count("<li id=") == 2)


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
