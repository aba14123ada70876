"""The token in Chromium: the printed address, links of other sites, and a bc-web that was started again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.helpers.driving import road_jpeg
from tests.helpers.logs import write_log
from tests.helpers.pages import opened_page, window_of, with_token
from tests.helpers.ports import free_ports
from tests.helpers.waiting import wait_until
from tests.helpers.wheel_host import driving_host
from tests.helpers.workbench import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ANOTHER = "the-token-of-the-next-start"


def write(folder: Path, name: str) -> None:
    write_log(folder / "sessions" / f"{name}.mcap", [0.1] * 20, lambda camera, row: road_jpeg(row))


def test_a_link_of_another_site_opens_nothing_but_a_way_on(browser: Browser, tmp_path: Path) -> None:
    write(tmp_path, "lake")
    with served(tmp_path) as bench:
        search = f"{bench.address}/sessions?where=speed_mph>5"
        with opened_page(browser, bench.address) as page:
            assert [cookie["sameSite"] for cookie in page.context.cookies()] == ["Strict"]
            # also one with the token, in somebody's mail; it is another site's until the person clicks here
            for link in (search, with_token(bench.address)):
                page.goto(f"data:text/html,<a href='{link}'>look</a>")
                page.click("a")
                page.wait_for_selector("text=another site led here")
                page.click("main a")
                page.wait_for_selector("#s-lake")
        with window_of(browser, 1280, 800) as page:  # without the cookie
            page.goto(search)
            assert "open the address that bc-web printed" in page.inner_text("main")


def test_a_page_of_an_earlier_start_goes_on_with_the_new_address(browser: Browser, tmp_path: Path) -> None:
    write(tmp_path, "lake")
    (port,) = free_ports(1)
    with window_of(browser, 1280, 800) as page:
        with served(tmp_path, port=port) as bench:
            page.goto(with_token(f"{bench.address}/sessions"))
            page.wait_for_selector("#s-lake")
        write(tmp_path, "mountain")
        with served(tmp_path, port=port, token=ANOTHER):
            page.wait_for_selector("#status:text('open the address that bc-web printed')")
            assert page.locator("#s-mountain").count() == 0
            second = page.context.new_page()
            second.goto(f"{bench.address}/sessions?token={ANOTHER}")
            second.wait_for_selector("#s-mountain")
            second.close()
            page.bring_to_front()
            page.wait_for_selector("#s-mountain")
            wait_until(lambda: not page.inner_text("#status"))


def test_the_wheel_of_an_earlier_start_is_held_with_the_new_address(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    (port,) = free_ports(1)
    with driving_host(tmp_path / "sessions" / "lake-1.mcap") as host, window_of(browser, 1280, 800) as page:
        with served(tmp_path, port=port) as bench:
            page.goto(with_token(f"{bench.address}{host.address}"))
            page.wait_for_selector("#wheel[data-holder=true][data-frame]")
        with served(tmp_path, port=port, token=ANOTHER):
            page.wait_for_selector("#problem:text('Open the address that bc-web printed')")
            second = page.context.new_page()
            second.goto(f"{bench.address}/sessions?token={ANOTHER}")
            second.close()
            page.bring_to_front()
            page.wait_for_selector("#problem", state="hidden")
            page.wait_for_selector("#wheel[data-holder=true]")
