"""Pages of the workbench in a browser: what their scripts raise fails the test."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal
from urllib.parse import urlsplit

from tests.helpers.waiting import PATIENCE_S, wait_until

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, ConsoleMessage, Page


TOKEN: Final = "the-token-of-the-tests"


def with_token(address: str) -> str:
    """The address with the token, as bc-web prints it."""
    parts = urlsplit(address)
    query = f"{parts.query}&token={TOKEN}" if parts.query else f"token={TOKEN}"
    return parts._replace(query=query).geturl()


@contextlib.contextmanager
def window_of(browser: Browser, width: int, height: int) -> Iterator[Page]:
    """The browser's one window, empty and of this size; another one would cost a second of processor time. What a
    page has left in it is gone afterwards, and so is the window where a test has failed in it."""
    context = browser.contexts[0] if browser.contexts else _new_context(browser)
    page = context.pages[0] if context.pages else context.new_page()
    page.set_default_timeout(PATIENCE_S * 1000)
    page.set_viewport_size({"width": width, "height": height})
    with contextlib.ExitStack() as unless_done:
        unless_done.callback(context.close)
        yield page
        page.evaluate("try { localStorage.clear(); sessionStorage.clear() } catch { /* about:blank has none */ }")
        page.goto("about:blank")
        page.emulate_media(color_scheme="light")
        page.mouse.move(0, 0)
        context.clear_cookies()
        unless_done.pop_all()


def _new_context(browser: Browser) -> BrowserContext:
    context = browser.new_context()
    # what a page says in passing stays: a test may look later than a person
    context.add_init_script(
        "const after = setTimeout;"
        "setTimeout = (call, ms, ...given) => after(call, ms === 8000 ? 1e9 : ms, ...given);"
    )
    return context


@contextlib.contextmanager
def heard(
    page: Page, event: Literal["console", "pageerror", "request"], handler: Callable[..., None]
) -> Iterator[None]:
    """Call `handler` of what happens in the page, until the context is left."""
    page.on(event, handler)
    try:
        yield
    finally:
        page.remove_listener(event, handler)


@contextlib.contextmanager
def opened_page(browser: Browser, address: str, *, width: int = 1280) -> Iterator[Page]:
    """A page, opened with the token, 1280x800 or as much larger as it is wider; nothing may go wrong in it."""
    errors: list[str] = []

    def printed(message: ConsoleMessage) -> None:
        # Rerun's viewer asks for what it may not; a refusal is what some tests are about, and said in the page
        is_expected = "/rerun/" in message.location["url"] or "status of 4" in message.text
        if message.type == "error" and not is_expected:
            errors.append(f"{message.text} ({message.location['url']})")

    with (
        window_of(browser, width, width * 5 // 8) as page,
        heard(page, "pageerror", lambda error: errors.append(str(error))),
        heard(page, "console", printed),
    ):
        page.goto(with_token(address))
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


def drop(page: Page, *dropped: Path) -> None:
    """Drop files or folders of this machine onto the page, as from a file manager."""
    session = page.context.new_cdp_session(page)
    data = {"items": [], "files": [str(path) for path in dropped], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "drop"):
        session.send("Input.dispatchDragEvent", {"type": kind, "x": 300, "y": 400, "data": data})
    session.detach()


def press(page: Page, key: str, shown: int) -> None:
    """Press a key that changes the tags; wait until the page of a session shows so many of them."""
    page.keyboard.press(key)
    page.wait_for_selector(f"#session[data-tags='{shown}']")
