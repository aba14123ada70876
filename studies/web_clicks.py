"""The clicks and keys that cleaning a session takes, in Chromium with a running bc-web.

python studies/web_clicks.py http://127.0.0.1:8080 SESSION

Beginning at the list of sessions, it looks at every crash and excludes it with the second before, tags every gap
as fine, and excludes all rows in which the car stands. It changes the session's tags.
"""

from __future__ import annotations

import os
import sys

from playwright.sync_api import sync_playwright

PROGRAM = "/usr/bin/chromium"
ACTIONS = (
    "#kinds [data-kind=crash]",
    "g",
    ",",
    "x",
    "#kinds [data-kind=gap]",
    "f",
    "#kinds [data-kind=standing_still]",
    "x",
)
"""Actions with # are clicks, the others are keys."""


def main() -> None:
    address, session = sys.argv[1:]
    flags = ["--no-sandbox"] if os.name == "posix" and os.geteuid() == 0 else []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=PROGRAM, args=flags)
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(f"{address}/sessions")
        page.click(f"a.name:text-is('{session}')")
        page.wait_for_selector("#session[data-ready]")
        for number, action in enumerate(ACTIONS, start=2):
            if action.startswith("#"):
                page.click(action)
            else:
                page.keyboard.press(action)
            page.wait_for_timeout(1000)  # as a person would, and until the change is written
            print(f"{number} {action}: {page.inner_text('#status')}")
        browser.close()


if __name__ == "__main__":
    main()
