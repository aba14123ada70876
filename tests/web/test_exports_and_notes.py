"""A recording and a network leave as downloads, and have the titles and notes that a user gives them."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder.import_cli
from recorder import Log
from tests.helpers.driving import road_jpeg, untrained_run
from tests.helpers.logs import write_log
from tests.helpers.pages import open_session, opened_page
from tests.helpers.udacity import call
from tests.helpers.workbench import served
from web.jobs import exports

if TYPE_CHECKING:
    from playwright.sync_api import Browser


def test_a_recording_is_downloaded_and_imported_again(browser: Browser, tmp_path: Path) -> None:
    log = write_log(tmp_path / "sessions" / "a.mcap", [0.1, -0.2, 0.3], lambda camera, row: road_jpeg(row))
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/sessions/a") as page:
        open_session(page)
        page.click("summary:text('Export')")
        with page.expect_download() as mcap:
            page.click("text=MCAP file")
        assert mcap.value.path().read_bytes() == log.read_bytes()
        page.click("text=Udacity folder")
        page.wait_for_selector("a:text('Download')")
        with page.expect_download() as udacity:
            page.click("a:text('Download')")
        assert udacity.value.suggested_filename == "a-udacity.zip"
        zipfile.ZipFile(udacity.value.path()).extractall(tmp_path)
    assert call(recorder.import_cli.main, tmp_path / "a-udacity", "b", "--sessions", log.parent) == 0
    with Log(log) as before, Log(log.parent / "b.mcap") as after:
        assert after.vehicle()["steering"] == before.vehicle()["steering"]
        assert after.picture(1) == before.picture(1)


def test_a_network_is_downloaded_if_its_packages_are_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    untrained_run(tmp_path / "runs" / "r")
    with served(tmp_path) as bench:
        started = bench.post("/runs/r/export/onnx")
        assert started.status == 303
        assert bench.post("/runs/r/export/pickle").status == 404
        monkeypatch.setattr(exports, "find_spec", lambda package: None)
        refused = bench.post("/runs/r/export/hub")
        assert refused.status == 501
        assert "onnx]" in refused.text


def test_a_recording_has_a_title_and_a_note(browser: Browser, tmp_path: Path) -> None:
    log = write_log(tmp_path / "sessions" / "a.mcap", [0.1] * 20)
    title = "Sunday morning, with the new wheel and a wet road"
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/sessions/a") as page:
        open_session(page)
        page.click("text=Name and note")
        page.fill("[name=title]", title)
        page.fill("[name=note]", "Three laps. <b>The last</b> is slow.")
        page.press("[name=title]", "Enter")
        page.wait_for_selector(f"h1:text('{title}')")
        assert page.inner_text(".note") == "Three laps. <b>The last</b> is slow."
        page.goto(f"{bench.address}/sessions?text=laps")
        name = page.locator(".session .name")
        assert name.inner_text() == "Sunday morning, w…l and a wet road"  # cut in the middle
        assert name.locator("span").get_attribute("title") == title
        (log.parent / "a.note.json").write_bytes(b"no json")
        assert "a</a>" in bench.get("/sessions").text
        assert bench.post("/sessions/a/note", title="x" * 81).status == 422
        assert bench.post("/sessions/a/note", title=" ").status == 303
    assert [path.name for path in log.parent.iterdir()] == ["a.mcap"]
