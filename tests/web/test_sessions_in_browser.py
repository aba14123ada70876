"""The list of sessions in a real browser: it keeps up with the commands, and is searched while one types."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import recorder.log_cli
from tests.helpers.driving import road_jpeg
from tests.helpers.logs import write_log
from tests.helpers.pages import open_session, opened_page, window_of, with_token
from tests.helpers.ports import free_ports
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser


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
