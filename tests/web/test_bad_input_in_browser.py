"""What a page makes of a log that nobody would want to look at: oddly named, with pictures that do not decode,
with thousands of tags, and replaced by another one while it is shown."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from driving import road_jpeg
from logs import write_log
from pages import drag, open_session, opened_page, press
from recorder import Log
from recorder.log.tags import Tag, add_tags, read_tags
from waiting import wait_until
from workbench import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

AWKWARD = "<img src=x onerror=alert(1)> & \"b\" 'c' 100%?#é\n;"
ROWS = 400
TAGS = 20_000


def test_a_log_that_is_awkward_in_every_way_is_shown_and_tagged(browser: Browser, tmp_path: Path) -> None:
    log = write_log(
        tmp_path / "sessions" / f"{AWKWARD}.mcap",
        [0.01 * (row % 40) for row in range(ROWS)],
        lambda camera, row: b"\xff\xd8\xff no picture" if camera == "left" else road_jpeg(row),
        cameras=["center", "left"],
    )
    with Log(log) as found:
        fingerprint = found.fingerprint
    many = [Tag(at % ROWS, min(at % ROWS + at // 400, ROWS - 1), f"n{at % 97}") for at in range(TAGS)]
    add_tags(log, fingerprint, many)
    with served(tmp_path) as bench, opened_page(browser, bench.address) as page:
        page.locator(".session .name").click()
        open_session(page)
        assert page.inner_text("h1") == AWKWARD.replace("\n", "\\n")
        shown = len(set(many))
        assert page.get_attribute("#session", "data-tags") == str(shown)
        assert page.locator("#tags li").count() < 1000  # all of them are in the curves
        page.wait_for_selector("[data-camera=left].missing")
        page.wait_for_selector("[data-camera=center]:not(.missing) img[src]")
        rows = drag(page, 100, 200, ROWS)
        press(page, "x", shown + 1)
        assert Tag(*rows, "exclude") in read_tags(log, fingerprint)
        press(page, "u", shown)
        assert Tag(*rows, "exclude") not in read_tags(log, fingerprint)

        write_log(tmp_path / "other.mcap", [0.5, 0.6]).replace(log)
        wait_until(lambda: "replaced by another" in page.inner_text("#problem"))
        page.keyboard.press("x")
        wait_until(lambda: "replaced since" in page.inner_text("#said"))
    with Log(log) as found:
        assert read_tags(log, found.fingerprint) == []  # rows of another log were not tagged
