"""What a page makes of a log that nobody would want to look at: oddly named, with pictures that do not decode,
with thousands of tags, with a disk that is full, growing, and replaced by another one while it is shown."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from recorder import Log, LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log.tags import Tag, add_tags, read_tags, tags_path
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import road_jpeg
from tests.helpers.logs import START_NS, write_log
from tests.helpers.pages import drag, open_session, opened_page, press
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

AWKWARD = "<img src=x onerror=alert(1)> & \"b\" 'c' 100%?#é\n;"
ROWS = 200
TAGS = 5_000


def test_a_log_that_is_being_recorded_grows_in_its_page(browser: Browser, tmp_path: Path) -> None:
    with served(tmp_path) as bench, LogWriter(tmp_path / "sessions" / "new.mcap", {}, live=True) as writer:
        rows = itertools.count()

        def record_until(is_seen: Callable[[], object]) -> None:
            """What is written is brought to the disk every second."""

            def write_and_look() -> object:
                row = next(rows)
                writer.vehicle(START_NS + row * 100_000_000, row, VehicleState(steering=0.1))
                return is_seen()

            wait_until(write_and_look)

        (part,) = (tmp_path / "sessions").glob("*.part")
        at = f"/sessions/{part.name}"
        record_until(lambda: bench.get(f"{at}/state").json.get("rows"))
        with opened_page(browser, f"{bench.address}{at}") as page:
            open_session(page)
            first = int(page.get_attribute("#curves", "aria-valuemax") or 0)
            record_until(lambda: int(page.get_attribute("#curves", "aria-valuemax") or 0) > first)
            page.keyboard.press("[")
            page.keyboard.press("x")
            wait_until(lambda: "unfinished" in page.inner_text("#status"))
    assert not list((tmp_path / "sessions").glob("*.jsonl"))


def test_a_log_that_is_awkward_in_every_way_is_shown_and_tagged(browser: Browser, tmp_path: Path) -> None:
    log = write_log(
        tmp_path / "sessions" / f"{AWKWARD}.mcap",
        [0.01 * (row % 40) for row in range(ROWS)],
        lambda camera, row: b"\xff\xd8\xff no picture" if camera == "left" else road_jpeg(row),
        cameras=["center", "left"],
    )
    with Log(log) as opened:
        fingerprint = opened.fingerprint
    many = [Tag(at % ROWS, min(at % ROWS + at // ROWS, ROWS - 1), f"n{at % 97}") for at in range(TAGS)]
    add_tags(log, fingerprint, many)
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/sessions") as page:
        page.locator(".session .name").click()
        open_session(page)
        assert page.inner_text("h1") == AWKWARD.replace("\n", "\\n")
        shown = len(set(many))
        assert page.get_attribute("#session", "data-tags") == str(shown)
        assert page.locator("#tags li").count() < 1000  # all of them are in the curves
        page.wait_for_selector("[data-camera=left].missing")
        page.wait_for_selector("[data-camera=center]:not(.missing) img[src]")
        rows = drag(page, 50, 100, ROWS)
        press(page, "x", shown + 1)
        assert Tag(*rows, "exclude") in read_tags(log, fingerprint)
        press(page, "u", shown)
        assert Tag(*rows, "exclude") not in read_tags(log, fingerprint)
        before = tags_path(log).read_bytes()
        with files_of_at_most(len(before) + 10):
            page.keyboard.press("x")
            wait_until(lambda: "cannot be written" in page.inner_text("#status"))
        assert tags_path(log).read_bytes() == before

        write_log(tmp_path / "other.mcap", [0.5, 0.6]).replace(log)
        wait_until(lambda: "replaced by another" in page.inner_text("#problem"))
        page.keyboard.press("x")
        wait_until(lambda: "replaced since" in page.inner_text("#status"))
    with Log(log) as opened:
        assert read_tags(log, opened.fingerprint) == []  # rows of another log were not tagged
