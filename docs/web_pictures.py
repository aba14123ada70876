"""Makes the pictures of docs/web.md: the pages of a project in Chromium without a window.

    python docs/web_pictures.py PROJECT --cleaned SESSION --predicted SESSION RUN --runs RUN RUN RUN
        --drives DRIVE DRIVE --compared SESSION --recording FOLDER

PROJECT is a copy of one with sessions, an index, runs and drives: a stretch is excluded in it, and an index tried.
Needs Playwright and Chromium; of what is drawn in Rerun, Debian's mesa-vulkan-drivers.
"""

from __future__ import annotations

import dataclasses
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final
from urllib.parse import urlencode

import tyro
from PIL import Image
from playwright.sync_api import Browser

from web.folders.project_folders import ProjectFolders
from web_browser import Pages, chromium, serving

_PHONE: Final = (390, 844)
_BETWEEN: Final = 16
_PLACES: Final = ("sessions", "index", "runs", "drives")
_MIDDLE: Final = """line => {
  const point = line.getPointAtLength(line.getTotalLength() / 2).matrixTransform(line.getScreenCTM());
  return [point.x, point.y];
}"""


@dataclass(frozen=True)
class WebPictures:
    """Make the pictures of docs/web.md."""

    project: Annotated[Path, tyro.conf.Positional]
    """A copy of a project: its folders by their usual names."""
    cleaned: str
    """A session with odd stretches; its second one is excluded, the third one selected."""
    predicted: tuple[str, str]
    """A session, and the run whose steering is shown over it."""
    runs: tuple[str, ...]
    """Runs to compare; of the first one, the page is shown, too."""
    drives: tuple[str, ...]
    """Drives on one map; of the first one, the page is shown, too."""
    compared: str
    """A session on which the first two runs are compared."""
    recording: Path
    """A recording of another program, which is dropped onto the page of imports."""
    only: tuple[str, ...] = ()
    """The names of the pictures to make; by default, all."""
    folder: Path = Path(__file__).parent / "pictures"
    """Where pictures are written; existing ones are replaced."""


class Shown(Pages):
    def __init__(self, browser: Browser, address: str, config: WebPictures) -> None:
        super().__init__(browser, address, config.folder)
        self.config = config


def sessions(shown: Shown) -> None:
    for name, is_dark in (("sessions", False), ("sessions-dark", True)):
        with shown.page("/sessions", 700, is_dark=is_dark) as page:
            page.wait_for_function("!document.querySelector('.count').textContent.includes('being read')")
            shown.keep(page, name)


def first_screen(shown: Shown) -> None:
    with (
        tempfile.TemporaryDirectory() as folder,
        serving(ProjectFolders(*map(Path(folder).joinpath, _PLACES))) as address,
    ):
        empty = Shown(shown.browser, address, shown.config)
        with empty.page("/", 700) as page:
            shown.keep(page, "first")


def imports(shown: Shown) -> None:
    """A recording is sent, and removed again."""
    with shown.page("/import", 420) as page:
        page.set_input_files("#folder", shown.config.recording)
        page.wait_for_selector(".recording")
        shown.keep(page, "import")
        page.click("text=Remove")


def wheel(shown: Shown) -> None:
    """A drive that is begun for the picture, ended, and deleted."""
    with shown.page("/wheel", 800) as page:
        page.fill("input[name=name]", "picture")
        page.click("button.main")
        page.wait_for_selector("#wheel[data-holder=true][data-frame]")
        page.keyboard.press("r")
        page.wait_for_timeout(8_000)
        page.keyboard.down("ArrowLeft")
        page.wait_for_timeout(150)
        shown.keep(page, "wheel")
        page.keyboard.up("ArrowLeft")
        page.keyboard.press("Escape")
        page.keyboard.press("Enter")
        page.wait_for_selector("#after form")
    Path("sessions", "picture.mcap").unlink()


def session(shown: Shown) -> None:
    """The second odd stretch is excluded, and the third one selected; then the same in the dark."""
    at = f"/sessions/{shown.config.cleaned}"
    with shown.page(at, 800) as page:
        for key in "jj":
            page.keyboard.press(key)
        page.keyboard.press("x")
        page.wait_for_selector("#session[data-tags='1']")
        page.keyboard.press("j")
        page.wait_for_selector("#status:has-text('are left')")
        shown.keep(page, "session")
    with shown.page(at, 800, is_dark=True) as page:
        for key in "jj":
            page.keyboard.press(key)
        shown.keep(page, "session-dark")


def prediction(shown: Shown) -> None:
    name, run = shown.config.predicted
    with shown.page(f"/sessions/{name}#run={run}", 820) as page:
        page.wait_for_selector(f"#session[data-run='{run}']")
        page.keyboard.press("w")
        page.keyboard.press("a")
        page.wait_for_selector("figure[data-attention]")
        page.wait_for_selector("#status:empty", state="attached")
        shown.keep(page, "session-run")


def in_rerun(shown: Shown) -> None:
    with shown.page(f"/sessions/{shown.config.cleaned}", 1080) as page:
        for key in "jjo":
            page.keyboard.press(key)
        page.wait_for_selector("#rerun[data-shown]")
        page.wait_for_timeout(20_000)  # nothing shows when all views are drawn
        # away from the strip at the foot: where that covers the viewer, Chromium's software leaves its top blank
        page.locator("#rerun iframe").evaluate("viewer => viewer.scrollIntoView({ block: 'center' })")
        shown.keep(page, "session-rerun")


def makers(shown: Shown) -> None:
    with shown.page(f"/sessions/{shown.config.cleaned}", 800) as page:
        for key in "jj":
            page.keyboard.press(key)
        page.click("#make summary")
        page.wait_for_function("document.querySelector('#make-trim code').textContent.includes('--rows')")
        page.evaluate("document.getElementById('make').scrollIntoView()")
        shown.keep(page, "session-make")


def index(shown: Shown) -> None:
    with shown.page("/index", 900) as page:
        page.fill("input[name=bins]", "15")
        page.fill("input[name=validation_share]", "0.3")
        page.click("text=See what would change")
        page.click("text=the result")  # once the job has ended
        shown.keep(page, "index")
    with shown.page("/index", 900) as page:
        page.click("text=Show samples as training sees them")
        page.wait_for_selector(".altered img")
        shown.keep(page, "augmentations", "#altered")


def runs(shown: Shown) -> None:
    chosen = urlencode([("run", run) for run in shown.config.runs])
    with shown.page(f"/runs?{chosen}", 960) as page:
        page.wait_for_selector(f"#plots[data-shown*='{shown.config.runs[-1]}']")
        shown.keep(page, "runs")
    with shown.page(f"/runs/{shown.config.runs[0]}", 1020) as page:
        page.wait_for_selector("#plots[data-shown]")
        shown.keep(page, "run")


def drives(shown: Shown) -> None:
    chosen = urlencode([*(("log", drive) for drive in shown.config.drives), ("by", "error")])
    with shown.page(f"/drives?{chosen}", 960) as page:
        page.wait_for_selector("#list svg polyline", state="attached")
        shown.keep(page, "drives")


def drive(shown: Shown) -> None:
    """A drive's page, with the mouse on the path of its map."""
    with shown.page(f"/drives/{shown.config.drives[0]}", 800) as page:
        page.wait_for_selector("#course-map .path", state="attached")
        page.mouse.move(*page.locator("#course-map .path").first.evaluate(_MIDDLE))
        shown.keep(page, "drive")


def comparison(shown: Shown) -> None:
    asked = urlencode({**dict(zip("ab", shown.config.runs, strict=False)), "session": shown.config.compared})
    with shown.page(f"/runs.compare?{asked}", 620) as page:
        if page.is_visible("#compared button"):
            page.click("#compared button")
        page.wait_for_selector("#compared svg")
        shown.keep(page, "compare")


def phone(shown: Shown) -> None:
    """Three pages side by side, as a phone shows them."""
    pages = ("/sessions", f"/sessions/{shown.config.cleaned}", f"/drives/{shown.config.drives[0]}")
    pictures = []
    for path in pages:
        with shown.page(path, _PHONE[1], width=_PHONE[0]) as page:
            pictures.append(shown.picture(page))
    together = Image.new("RGB", (len(pages) * (_PHONE[0] + _BETWEEN) - _BETWEEN, _PHONE[1]), "grey")
    for at, picture in enumerate(pictures):
        together.paste(picture, (at * (_PHONE[0] + _BETWEEN), 0))
    shown.save(together, "phone")


def jobs(shown: Shown) -> None:
    """What was started is a recording, which is removed again."""
    with shown.page("/jobs?start=record", 760) as page:
        for name, value in (("name", "another"), ("track", "mountain"), ("laps", "0.03")):
            page.fill(f"details[open] input[name={name}]", value)
        page.click("details[open] button")
        page.click("text=the result")  # once the job has ended
    Path("sessions/another.mcap").unlink()
    with shown.page("/jobs?start=train", 760) as page:
        page.fill("details[open] input[name=name]", "first")
        page.fill("details[open] input[name=epochs]", "4")
        page.wait_for_selector("text=bc-train --name=first --epochs=4", state="attached")
        shown.keep(page, "jobs")


PICTURES: Final = (
    first_screen,
    imports,
    wheel,
    sessions,
    jobs,
    index,
    session,
    prediction,
    in_rerun,
    makers,
    runs,
    comparison,
    drives,
    drive,
    phone,
)


def main(config: WebPictures) -> None:
    config = dataclasses.replace(config, folder=config.folder.absolute(), recording=config.recording.absolute())
    os.chdir(config.project)  # paths are shown as they are typed there
    wanted = [make for make in PICTURES if not config.only or make.__name__ in config.only]
    with serving(ProjectFolders()) as address, chromium() as browser:
        for make in wanted:
            make(Shown(browser, address, config))


if __name__ == "__main__":
    main(tyro.cli(WebPictures))
