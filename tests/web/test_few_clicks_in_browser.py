"""What somebody wants to know is a few clicks away from any page; each test says how many."""

from __future__ import annotations

import contextlib
import json
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.helpers.drives import a_drive
from tests.helpers.driving import road_jpeg, untrained_run
from tests.helpers.histories import epoch_line, write_lines
from tests.helpers.logs import write_log
from tests.helpers.pages import opened_page, with_token
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser


def learnt_run(folder: Path, seed: int) -> None:
    """A run that says that it has learnt an epoch."""
    run = untrained_run(folder, seed)
    config = json.loads((run / "config.json").read_text())
    config.update(training={"epochs": 1, "recipe": "people"}, data={})
    (run / "config.json").write_text(json.dumps(config))
    write_lines(run / "metrics.jsonl", [epoch_line(1)])
    os.utime(run / "model.safetensors", (1e9 + seed, 1e9 + seed))


def test_two_clicks_compare_the_newest_two_runs(browser: Browser, tmp_path: Path) -> None:
    for number, name in enumerate(("old", "newer", "newest")):
        learnt_run(tmp_path / "runs" / name, number)
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/sessions") as page:
        wait_until(lambda: "reading" not in bench.get("/runs").text)
        page.click("nav >> text=Networks")
        page.click("text=Compare the newest two")
        page.wait_for_url("**/runs.compare?*")
        assert page.locator("h1").inner_text() == "newer and newest, on the same frames"
        assert bench.get("/jobs").text.count("<li id=") == 1


def test_three_clicks_show_why_a_drive_left_the_road(browser: Browser, tmp_path: Path) -> None:
    learnt_run(tmp_path / "runs" / "r", 0)
    a_drive(tmp_path / "drives" / "d.mcap", "r", road_jpeg)
    write_log(tmp_path / "sessions" / "a.mcap", [0.1] * 5)
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/sessions") as page:
        wait_until(lambda: "the first intervention" in bench.get("/drives").text)
        page.click("nav >> text=Test drives")
        page.click("td a[title^='the first intervention']")
        page.wait_for_selector("#session[data-run=r]")  # what the network steers
        wait_until(lambda: page.get_attribute("#curves", "aria-valuenow") == "5")  # where it was put back
        page.wait_for_selector("#session[data-course] #course-map circle", state="attached")
        page.click("#attention")  # and where it looks
        page.wait_for_selector("figure[data-attention*='/r/5?'] .attention")


def test_four_clicks_and_keys_drive_learn_and_watch_the_network_drive(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From an empty project, by the real commands. It prints the time of each step."""
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    began_s = time.monotonic()

    def note(step: str) -> None:
        print(f"{step}: {time.monotonic() - began_s:.0f} s")

    with served(tmp_path / "project") as bench, opened_page(browser, bench.address) as page:
        page.click(".hero a[href='/wheel']")
        page.click("button:text('Take the wheel')")
        page.wait_for_selector("#wheel[data-holder=true][data-frame]")
        note("at the wheel")
        page.keyboard.press("r")
        page.keyboard.down("ArrowUp")
        wait_until(lambda: int(page.inner_text("#rows").split()[0]) >= 100)
        page.keyboard.up("ArrowUp")
        page.keyboard.press("Escape")
        page.keyboard.press("Enter")
        note("driven")
        page.click("button:text('Train on it')")
        page.click("button:has-text('Let it drive')")
        note("learnt")
        page.wait_for_selector("#wheel[data-holder=true][data-frame]")
        wait_until(lambda: "the network drives" in page.inner_text("#driver"))
        note("the network drives")
        page.keyboard.press("Escape")
        page.keyboard.press("Enter")
        page.wait_for_selector("#after button")


@pytest.mark.parametrize("size", [(390, 844), (844, 390)], ids=["upright", "lying"])
def test_on_a_phone_a_drive_needs_no_scrolling(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: tuple[int, int]
) -> None:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    width, height = size
    with (
        served(tmp_path / "project") as bench,
        contextlib.closing(
            browser.new_context(viewport={"width": width, "height": height}, has_touch=True, is_mobile=True)
        ) as context,
    ):
        page = context.new_page()

        def tap(selector: str) -> None:
            page.wait_for_selector(f"{selector} >> visible=true")
            box = page.locator(selector).first.bounding_box()
            assert box is not None
            assert 0 <= box["y"] <= height - box["height"], selector
            page.touchscreen.tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)

        page.goto(with_token(f"{bench.address}/"))
        tap(".hero a[href='/wheel']")
        page.click("button:text('Take the wheel')")  # below the settings, which nobody has to change
        page.wait_for_selector("#wheel[data-holder=true][data-frame]")
        tap("#record")
        wait_until(lambda: int(page.inner_text("#rows").split()[0]) >= 20)
        tap("#end")
        tap("#confirm button.main")
        page.wait_for_selector("#after button")
        assert "Train on it" in page.inner_text("#after")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
