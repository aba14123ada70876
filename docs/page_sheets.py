"""Makes docs/pictures/pages/: each page of the workbench at four sizes, the second one in the dark.

    python docs/page_sheets.py PROJECT

PROJECT has sessions, an index, two runs and two drives, as bc-demo makes them. Needs Playwright and Chromium.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final
from urllib.parse import quote, urlencode

import tyro
from PIL import Image
from playwright.sync_api import Page

from web.folders.project_folders import ProjectFolders
from web_browser import Pages, chromium, serving

SIZES: Final = (390, 844), (768, 1024), (1280, 800), (1920, 1080)
DARK: Final = (768, 1024)
_SCALE: Final = 0.6
_GAP: Final = 12
_QUALITY: Final = 62
_PLACES: Final = ("sessions", "index", "runs", "drives")


@dataclass(frozen=True)
class PageSheets:
    """Make a picture of each page of the workbench at four sizes."""

    project: Annotated[Path, tyro.conf.Positional]
    """A project: its folders by their usual names."""
    only: tuple[str, ...] = ()
    """The names of the sheets to make; by default, all."""
    folder: Path = Path(__file__).parent / "pictures" / "pages"
    """Where they are written; existing ones are replaced."""


@dataclass(frozen=True)
class Shown:
    """A page, and what stands in it when all of it is there."""

    name: str
    path: str
    last: str
    then: Callable[[Page], object] = lambda page: None


def pages_of(project: ProjectFolders) -> Iterator[Shown]:
    """Every page, of the newest run and the first of each other kind."""
    session, drive = sorted(project.logs("sessions"))[0], sorted(project.logs("drives"))[0]
    runs = list(project.run_folders())
    chosen = urlencode([("run", run) for run in runs])
    yield Shown("home", "/", "main a.main, main button.main")
    yield Shown("sessions", "/sessions", ".session .strip img")
    yield Shown("import", "/import", "#drop")
    yield Shown("session", f"/sessions/{session}", "#session[data-ready]", lambda page: page.keyboard.press("j"))
    yield Shown("map", "/map", "#map[data-shown]:not([data-shown=''])", _drag_on_map)
    yield Shown("index", "/index", "main img")
    yield Shown("runs", f"/runs?{chosen}", "#plots canvas")
    yield Shown("run", f"/runs/{runs[0]}", "#plots canvas")
    yield Shown("scatter", f"/runs/{runs[0]}", "#scatter-show", _scatter)
    if len(runs) > 1:
        yield Shown(
            "compare",
            f"/runs.compare?{urlencode({'a': runs[0], 'b': runs[1]})}",
            "main form, #compared svg",
            _compare,
        )
    drives = urlencode([("log", key) for key in project.logs("drives")])
    yield Shown("drives", f"/drives?{drives}&by=error", "#list table")
    yield Shown("drive", f"/drives/{drive}", "#session[data-course]")
    yield Shown("jobs", "/jobs", "main h1")
    yield Shown("wheel", "/wheel", "form.begin")
    yield Shown("after-a-drive", f"/wheel/after/sessions/{quote(session)}", "form")
    yield Shown("missing", "/runs/none", "main h1")


def _compare(page: Page) -> None:
    if page.is_visible("#compared button"):
        page.click("#compared button")
    page.wait_for_selector("#compared svg")


def _scatter(page: Page) -> None:
    page.click("#scatter-show")
    page.wait_for_selector("#scatter[data-shown]")
    page.locator("#scatter").evaluate("section => section.scrollIntoView()")
    page.focus("#scatter-cloud")
    page.keyboard.press("ArrowRight")


def _drag_on_map(page: Page) -> None:
    box = page.locator("#cloud").bounding_box()
    if box is None:
        return
    for number, (across, down) in enumerate(((0.2, 0.3), (0.5, 0.25), (0.5, 0.7), (0.25, 0.65))):
        page.mouse.move(box["x"] + box["width"] * across, box["y"] + box["height"] * down)
        if not number:
            page.mouse.down()
    page.mouse.up()


def sheet(pictures: Sequence[Image.Image]) -> Image.Image:
    """Pictures side by side, on grey."""
    small = [each.resize([round(_SCALE * px) for px in each.size], Image.Resampling.LANCZOS) for each in pictures]
    width = sum(each.width + _GAP for each in small) + _GAP
    made = Image.new("RGB", (width, max(each.height for each in small) + 2 * _GAP), "#888888")
    left = _GAP
    for each in small:
        made.paste(each, (left, _GAP))
        left += each.width + _GAP
    return made


def main(config: PageSheets) -> None:
    config.folder.mkdir(parents=True, exist_ok=True)
    folder = config.folder.absolute()
    os.chdir(config.project)  # paths are shown as they are typed there
    with tempfile.TemporaryDirectory() as empty, chromium() as browser:
        for folders, are_pages in ((ProjectFolders(), pages_of), (_new(Path(empty)), _first_page)):
            with serving(folders) as address:
                pages = Pages(browser, address, folder)
                for shown in are_pages(folders):
                    if not config.only or shown.name in config.only:
                        keep(pages, shown, folder / f"{shown.name}.webp")


def _new(folder: Path) -> ProjectFolders:
    return ProjectFolders(*map(folder.joinpath, _PLACES))


def _first_page(folders: ProjectFolders) -> Iterator[Shown]:
    yield Shown("first", "/", ".hero")


def keep(pages: Pages, shown: Shown, path: Path) -> None:
    pictures = []
    for width, height in SIZES:
        with pages.page(shown.path, height, width=width, is_dark=(width, height) == DARK) as page:
            page.wait_for_selector(shown.last, state="attached")
            shown.then(page)
            pictures.append(pages.picture(page))
    sheet(pictures).save(path, quality=_QUALITY, method=6)
    print(path)


if __name__ == "__main__":
    main(tyro.cli(PageSheets))
