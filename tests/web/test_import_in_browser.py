"""Importing in a real browser: a folder is chosen, a zip or folder dropped, and cancelled while it is sent."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import recorder.import_cli
from recorder import Log
from tests.helpers.pages import drop, open_session, opened_page
from tests.helpers.udacity import call, make_recording, paths
from tests.helpers.upload_bodies import zipped
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

CSV = "".join(f"{paths(number)},0.1,0.5,0,9.5\n" for number in range(3))


def test_a_chosen_folder_becomes_a_session_by_the_keyboard(browser: Browser, tmp_path: Path) -> None:
    make_recording(tmp_path / "mine" / "lake", CSV)
    with served(tmp_path / "project") as bench, opened_page(browser, bench.address) as page:
        page.click(".hero a[href='/import']")
        page.wait_for_selector("#drop")
        page.wait_for_load_state()  # with its scripts
        with page.expect_file_chooser() as chooser:
            page.press("#folder", "Enter")
        chooser.value.set_files(tmp_path / "mine" / "lake")
        page.wait_for_selector("text=3 rows")
        assert page.input_value("input[name=name]") == "lake"
        page.press("input[name=name]", "Enter")
        open_session(page)  # which opens by itself
    sessions = tmp_path / "mine" / "sessions"
    assert call(recorder.import_cli.main, tmp_path / "mine" / "lake", "lake", "--sessions", sessions) == 0
    with (
        Log(tmp_path / "project" / "sessions" / "lake.mcap") as by_page,
        Log(sessions / "lake.mcap") as by_command,
    ):
        assert by_page.vehicle() == by_command.vehicle()


def test_a_folder_and_a_zip_are_dropped(browser: Browser, tmp_path: Path) -> None:
    folder = tmp_path / "mine" / "lake"
    make_recording(folder, CSV)
    # more than a browser lists at a time
    for number in range(150):
        (folder / "IMG" / f"other_{number}.txt").write_bytes(b"")
    (tmp_path / "second.zip").write_bytes(zipped({"driving_log.csv": CSV.encode()}))
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/import") as page:
        drop(page, folder)
        page.wait_for_selector("text=3 rows")
        sent = sorted(path.name for path in (tmp_path / "recordings" / "lake").rglob("*"))
        assert sent == sorted(path.name for path in folder.rglob("*"))
        page.click("text=Import another")
        page.wait_for_url("**/import")  # until its script listens
        drop(page, tmp_path / "second.zip")
        page.wait_for_selector("text=none of its pictures is there")
        page.click("text=Remove")
        page.wait_for_selector("text=Uploaded before")
        assert not (tmp_path / "recordings" / "second").exists()


def test_several_recordings_are_imported_at_once_and_marked_after_it(browser: Browser, tmp_path: Path) -> None:
    make_recording(tmp_path / "mine" / "lake", CSV)
    make_recording(tmp_path / "mine" / "hill", CSV)
    (tmp_path / "third.zip").write_bytes(zipped({"driving_log.csv": CSV.encode()}))  # without pictures
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/import") as page:
        page.wait_for_load_state()
        drop(page, tmp_path / "mine" / "lake", tmp_path / "mine" / "hill", tmp_path / "third.zip")
        page.click("text=Import all")
        wait_until(lambda: {"lake", "hill"} <= {log.stem for log in (tmp_path / "sessions").glob("*.mcap")})
        assert sorted(path.name for path in (tmp_path / "recordings").iterdir()) == ["lake-and-2-more"]
        page.goto(f"{bench.address}/import/lake-and-2-more")
        assert page.locator("text=Already here as").count() == 2
        assert not page.locator("text=Import all").count()


def test_a_folder_of_any_number_of_files_is_listed(browser: Browser, tmp_path: Path) -> None:
    """A function call takes only about a hundred thousand arguments."""
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/import") as page:
        page.wait_for_load_state()
        page.evaluate(
            """() => {
                const content = new File([], "a");
                const file = { isFile: true, fullPath: "/lake/IMG/a", file: (done) => done(content) };
                const reader = (parts) => ({ readEntries: (done) => done(parts.shift() ?? []) });
                const folder = (parts) => ({ createReader: () => reader(parts) });
                const batches = Array.from({ length: 3001 }, () => Array(100).fill(file));
                const item = { webkitGetAsEntry: () => folder([[folder(batches)]]), getAsFile: () => null };
                document.dispatchEvent(Object.assign(new Event("drop"), { dataTransfer: { items: [item] } }));
            }"""
        )
        page.wait_for_selector("#problem:visible")
        assert page.inner_text("#problem") == "300100 files: at most 300000 are allowed."


def test_a_cancelled_upload_leaves_nothing(browser: Browser, tmp_path: Path) -> None:
    (tmp_path / "large").mkdir()
    with (tmp_path / "large" / "hole").open("wb") as stream:
        stream.truncate(3 << 30)
    with served(tmp_path / "project") as bench, opened_page(browser, f"{bench.address}/import") as page:
        drop(page, tmp_path / "large")
        page.wait_for_selector("#cancel:focus")
        wait_until(lambda: list((tmp_path / "project").glob("recordings/*")))
        page.keyboard.press("Enter")
        wait_until(lambda: "nothing was kept" in page.inner_text("#status"))
        wait_until(lambda: not (tmp_path / "project" / "recordings").exists())
        assert page.is_hidden("#progress")


def test_what_is_refused_is_shown_in_the_page(browser: Browser, tmp_path: Path) -> None:
    (tmp_path / "a.zip").write_bytes(b"no zip")
    with served(tmp_path / "project") as bench, opened_page(browser, f"{bench.address}/import") as page:
        drop(page, tmp_path / "a.zip")
        page.wait_for_selector("#problem:text('cannot be unpacked')")
        (tmp_path / "empty").mkdir()
        drop(page, tmp_path / "empty")
        page.wait_for_selector("#problem:text('no file in it')")
