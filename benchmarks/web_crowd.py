"""Ten windows of Chromium that scrub at once, each with a profile of its own."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final

from playwright.async_api import Browser, Page, async_playwright

BROWSERS: Final = 10
MOVES_HZ: Final = 30
_PATIENCE_MS: Final = 300_000


@dataclass(frozen=True)
class Scrubbed:
    """A page whose pictures follow the mouse."""

    address: str
    ready: str  # a selector of what is there once it can be scrubbed
    over: str  # of what the mouse moves along
    watch: str  # JavaScript that measures the milliseconds from each move to its pictures, and what it is given
    asked: Sequence[object]


@dataclass(frozen=True)
class Crowd:
    """What ten windows saw."""

    waits_ms: list[float]
    moves: int  # that all of them made together: a window that is busy makes fewer than it is asked to
    seconds: float


def crowd(program: str, flags: Sequence[str], page: Scrubbed, seconds: float) -> Crowd:
    """On a thread of its own: an event loop may run here already."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, _crowd(program, flags, page, seconds)).result()


async def _crowd(program: str, flags: Sequence[str], asked: Scrubbed, seconds: float) -> Crowd:
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path=program, args=list(flags))
        pages = [await _opened(browser, asked) for _ in range(BROWSERS)]
        begun_s = time.perf_counter()
        moves = await asyncio.gather(*(_scrub(page, asked, begun_s, seconds) for page in pages))
        took_s = time.perf_counter() - begun_s
        await asyncio.sleep(1)
        waits: list[float] = []
        for page in pages:
            waits += await page.evaluate("window.waits")
        await browser.close()
    return Crowd(waits, sum(moves), took_s)


async def _opened(browser: Browser, asked: Scrubbed) -> Page:
    context = await browser.new_context(viewport={"width": 1280, "height": 800})
    page = await context.new_page()
    page.set_default_timeout(_PATIENCE_MS)
    await page.goto(asked.address)
    await page.wait_for_selector(asked.ready)
    await page.evaluate(asked.watch, asked.asked)
    return page


async def _scrub(page: Page, asked: Scrubbed, begun_s: float, seconds: float) -> int:
    """How many moves were made until the time was over; each waits until the window has heard of it."""
    box = await page.locator(asked.over).first.bounding_box()
    assert box is not None  # noqa: S101
    moves = 0
    while (gone_s := time.perf_counter() - begun_s) < seconds:
        share = gone_s / seconds
        await page.mouse.move(box["x"] + 2 + (box["width"] - 4) * share, box["y"] + box["height"] / 2)
        moves += 1
        await asyncio.sleep(max(0.0, begun_s + moves / MOVES_HZ - time.perf_counter()))
    return moves
