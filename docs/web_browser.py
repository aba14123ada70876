"""The workbench in Chromium without a window, and the pictures that are made of its pages."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from web.app import workbench_app
from web.folders.project_folders import ProjectFolders
from web.server.workbench_server import WorkbenchServer

WIDTH: Final = 1280
_COLORS: Final = 256
_LARGE_BYTES: Final = 120_000
_PATIENCE_MS: Final = 600_000  # a network looks at a whole session


class Pages:
    """The workbench in a browser, and the pictures that are made of it."""

    def __init__(self, browser: Browser, address: str, folder: Path) -> None:
        self.browser = browser
        self._folder = folder
        self._address = address

    @contextlib.contextmanager
    def page(self, path: str, height: int, *, is_dark: bool = False, width: int = WIDTH) -> Iterator[Page]:
        size = {"width": width, "height": height}
        scheme = "dark" if is_dark else "light"
        # bypass_csp: wait_for_function polls by an eval in the page, which the pages' policy forbids
        page = self.browser.new_page(viewport=size, color_scheme=scheme, bypass_csp=True)  # type: ignore[arg-type]
        page.set_default_timeout(_PATIENCE_MS)
        page.goto(f"{self._address}{path}", wait_until="networkidle")
        if path.startswith(("/sessions/", "/drives/")):
            page.wait_for_selector("#session[data-ready]")
        yield page
        page.close()

    def keep(self, page: Page, name: str, selector: str = "") -> None:
        """All of the window, or an element of it; once all its pictures are there."""
        self.save(self.picture(page, selector), name)

    def picture(self, page: Page, selector: str = "") -> Image.Image:
        page.wait_for_function("[...document.images].every(each => each.complete || each.loading === 'lazy')")
        time.sleep(1)
        data = page.locator(selector).screenshot() if selector else page.screenshot()
        return Image.open(io.BytesIO(data)).convert("RGB")

    def save(self, picture: Image.Image, name: str) -> None:
        path = self._folder / f"web-{name}.png"
        picture.save(path, optimize=True)
        if path.stat().st_size > _LARGE_BYTES:
            picture.quantize(_COLORS).save(path, optimize=True)
        print(path)


@contextlib.contextmanager
def chromium() -> Iterator[Browser]:
    """Chromium without a window, which draws WebGL in software."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    flags = ["--enable-unsafe-swiftshader"]
    if os.name == "posix" and os.geteuid() == 0:
        flags.append("--no-sandbox")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=flags)
        yield browser
        browser.close()


@contextlib.contextmanager
def serving(folders: ProjectFolders) -> Iterator[str]:
    """The address of a workbench over these folders."""
    with (
        tempfile.TemporaryDirectory() as cache,
        workbench_app(folders, "127.0.0.1", "", Path(cache)) as app,
    ):
        server = WorkbenchServer(app, "127.0.0.1", 0)
        server.start()
        try:
            yield f"http://127.0.0.1:{server.port}"
        finally:
            server.stop()
