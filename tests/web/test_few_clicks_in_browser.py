"""What somebody wants to know is a few clicks away from any page; each test says how many."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

from drives import a_drive
from driving import road_jpeg, untrained_run
from histories import epoch_line, write_lines
from logs import write_log
from pages import opened_page
from waiting import wait_until
from workbench import served

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
        wait_until(lambda: "reading" not in bench.get("/runs.rows").text)
        page.click("nav >> text=Runs")
        page.click("text=Compare the newest two")
        page.wait_for_url("**/runs.compare?*")
        assert page.locator("h1").inner_text() == "newer and newest, on the same frames"
        assert bench.get("/jobs.rows").text.count("<li id=") == 1


def test_three_clicks_show_why_a_drive_left_the_road(browser: Browser, tmp_path: Path) -> None:
    learnt_run(tmp_path / "runs" / "r", 0)
    a_drive(tmp_path / "drives" / "d.mcap", "r", road_jpeg)
    write_log(tmp_path / "sessions" / "a.mcap", [0.1] * 5)
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/sessions") as page:
        wait_until(lambda: "the first one" in bench.get("/drives").text)
        page.click("nav >> text=Drives")
        page.click("td a[title^='the first one']")
        page.wait_for_selector("#session[data-run=r]")  # what the network steers
        wait_until(lambda: page.get_attribute("#curves", "aria-valuenow") == "5")  # where it was put back
        page.wait_for_selector("#session[data-course] #course-map circle", state="attached")
        page.click("#attention")  # and where it looks
        page.wait_for_selector("figure[data-attention*='/r/5?'] .attention")
