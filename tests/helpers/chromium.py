"""Debian's Chromium without a window, told what to do by Playwright."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

import pytest

from waiting import PATIENCE_S

if TYPE_CHECKING:
    from playwright.sync_api import Browser

PROGRAMS: Final = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@contextlib.contextmanager
def chromium() -> Iterator[Browser]:
    """Skips the test where there is no Chromium, or no Playwright."""
    api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: pages were not tried")
    program = next(filter(None, map(shutil.which, PROGRAMS)), "")
    if not program or os.name != "posix":
        pytest.skip("pages were not tried in a browser: no Chromium here (Debian: apt install chromium)")
    flags = [
        "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",  # it reaches this machine only
        "--enable-unsafe-swiftshader",  # newer ones draw WebGL in software only if they are told to
        # Rerun's viewer, 40 MB of WebAssembly, is here for seconds: compiled once, and of it what runs
        "--js-flags=--wasm-lazy-compilation --no-wasm-tier-up",
    ]
    if os.geteuid() == 0:
        flags.append("--no-sandbox")  # it refuses to run as root with one
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=flags, timeout=PATIENCE_S * 1000)
        try:
            yield browser
        finally:
            browser.close()
