"""Debian's Chromium without a window, told what to do by Playwright."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

from tests.helpers.needs import CHROMIUM, require
from tests.helpers.waiting import PATIENCE_S

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@contextlib.contextmanager
def chromium() -> Iterator[Browser]:
    require("chromium")
    from playwright.sync_api import sync_playwright  # slow

    flags = [
        "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",  # it reaches this machine only
        "--enable-unsafe-swiftshader",  # newer ones draw WebGL in software only if they are told to
        # Rerun's viewer, 40 MB of WebAssembly, is here for seconds: compiled once, and of it what runs
        "--js-flags=--wasm-lazy-compilation --no-wasm-tier-up",
    ]
    if os.geteuid() == 0:
        flags.append("--no-sandbox")  # it refuses to run as root with one
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags, timeout=PATIENCE_S * 1000)
        try:
            yield browser
        finally:
            browser.close()
