"""Pages of the workbench in a browser: what their scripts raise fails the test."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from waiting import PATIENCE_S, wait_until

if TYPE_CHECKING:
    from playwright.sync_api import Browser, ConsoleMessage, Page


@contextlib.contextmanager
def opened_page(browser: Browser, address: str, *, is_dark: bool = False, width: int = 1280) -> Iterator[Page]:
    """A window, 1280x800 or as much larger as it is wider; nothing may go wrong in it."""
    scheme = "dark" if is_dark else "light"
    size = {"width": width, "height": width * 5 // 8}
    page = browser.new_page(viewport=size, color_scheme=scheme)  # type: ignore[arg-type]
    page.set_default_timeout(PATIENCE_S * 1000)
    errors: list[str] = []

    def heard(said: ConsoleMessage) -> None:
        # Rerun's viewer asks for what it may not; a refusal is what some tests are about, and said in the page
        is_expected = "/rerun/" in said.location["url"] or "status of 4" in said.text
        if said.type == "error" and not is_expected:
            errors.append(f"{said.text} ({said.location['url']})")

    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", heard)
    with contextlib.closing(page):
        page.goto(address)
        yield page
        assert not errors, errors


def open_session(page: Page) -> None:
    """Wait until the page of a session has all of its data."""
    page.wait_for_selector("#session[data-ready]")


def selected_rows(page: Page) -> tuple[int, int]:
    """The rows that the page of a session says are selected, once there are any."""
    words = wait_until(lambda: page.inner_text("#selected")).split()
    return int(words[1]), int(words[3])


def drag(page: Page, first: int, last: int, rows: int) -> tuple[int, int]:
    """Drag over the curves of a session of so many rows; the rows that the page says are selected."""
    box = page.locator("#curves .u-over").first.bounding_box()
    assert box is not None
    across = [box["x"] + box["width"] * row / (rows - 1) for row in (first, last)]
    y = box["y"] + box["height"] / 2
    page.mouse.move(across[0], y)
    page.mouse.down()
    page.mouse.move(across[1], y, steps=4)
    page.mouse.up()
    return selected_rows(page)


def press(page: Page, key: str, shown: int) -> None:
    """Press a key that changes the tags; wait until the page of a session shows so many of them."""
    page.keyboard.press(key)
    page.wait_for_selector(f"#session[data-tags='{shown}']")
