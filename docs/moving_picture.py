"""Makes the README's moving picture: somebody drives with the arrow keys, trains, and lets the network drive.

    python docs/moving_picture.py

All of it happens, in Chromium on the pages of bc-web. The person is a program that knows what the page is sent:
where the car is on the map. It taps the arrow keys, each for as long as the road ahead asks for, and drives half a
lap of the lake at 10 mph. *Train on it* trains a network on that drive alone, by default options, and *Let it
drive* lets this network drive. Both drives are played at the simulated time, however long the computer takes for
a picture; the training is shown in time lapse.

Needs Playwright and Chromium.
"""

from __future__ import annotations

import base64
import contextlib
import io
import itertools
import json
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from urllib.parse import urljoin

import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from playwright.sync_api import Browser, Page, WebSocket

from common.car import MAX_STEERING_DEG, MPS_PER_MPH
from simulator.driving.vehicle import WHEELBASE_M
from web.folders.project_folders import ProjectFolders
from web_browser import chromium, serving

PICTURE: Final = Path(__file__).absolute().parent / "pictures" / "drive-train-drive.webp"
NAME: Final = "my-drive"
RUN: Final = f"net-{NAME}"
LAPS: Final = 0.5
DRIVEN_AT, NETWORK_AT, FILMED_S = 0.335, 0.575, 6.5
"""The place on the track at which the pictures of each drive begin, in laps: the sharpest bend of each half. Their
length in seconds."""

_WINDOW: Final = {"width": 720, "height": 484}
_WIDTH, _CAPTION_PX = 640, 40
_BLUE: Final = "#0b57a4"
_STEP_S: Final = 0.08  # between two pictures of a drive
_LAPSE: Final = 10  # pictures of the training
_PATIENCE_MS: Final = 1_800_000
_LOOK_AHEAD_S: Final = 1.6
_TAP_EVERY_S: Final = 0.4
_KEY_PER_S: Final = 3.0  # of full lock, there and back (web/static/js/wheel/keys.js)
_PAINTED: Final = """window.painted = [];
addEventListener("DOMContentLoaded", () => {
  const wheel = document.getElementById("wheel");
  let key = "";
  addEventListener("keydown", (event) => (key = event.key));
  addEventListener("keyup", () => (key = ""));
  const note = () => painted.push([Date.now() / 1000, Number(wheel.dataset.frame), key]);
  if (wheel) new MutationObserver(note).observe(wheel, {attributeFilter: ["data-frame"]});
});"""


Shown = tuple[float, bytes, str]
"""Simulated seconds, a picture of the page, and the key that is held."""


class Film:
    """Pictures with a caption, and how long each is shown."""

    def __init__(self) -> None:
        self.pictures: list[Image.Image] = []
        self.shown_ms: list[int] = []
        self._font = ImageFont.load_default(21)

    def add(self, data: bytes, caption: str, seconds: float, key: str | None = None) -> None:
        """A picture of the page. `key`: the arrow key that is held, or ""; None shows no keys at the caption."""
        page = Image.open(io.BytesIO(data)).convert("RGB")
        page = page.resize((_WIDTH, round(_WIDTH * page.height / page.width)), Image.Resampling.LANCZOS)
        picture = Image.new("RGB", (_WIDTH, page.height + _CAPTION_PX), _BLUE)
        picture.paste(page, (0, _CAPTION_PX))
        middle = (_WIDTH / 2, _CAPTION_PX / 2)
        draw = ImageDraw.Draw(picture)
        draw.text(middle, caption, "white", self._font, anchor="mm")
        for at, (name, way) in enumerate({"ArrowLeft": -1, "ArrowRight": 1}.items() if key is not None else ()):
            x, y = _WIDTH - 90 + 42 * at, _CAPTION_PX // 2
            draw.rounded_rectangle((x - 17, y - 15, x + 17, y + 15), 5, "white" if key == name else None, "white")
            draw.polygon(
                [(x + 8 * way, y), (x - 6 * way, y - 8), (x - 6 * way, y + 8)], _BLUE if key == name else "white"
            )
        self.pictures.append(picture)
        self.shown_ms.append(round(1000 * seconds))

    def save(self, path: Path) -> None:
        first, *others = self.pictures
        first.save(path, save_all=True, append_images=others, duration=self.shown_ms, loop=0, quality=72, method=4)
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB, {sum(self.shown_ms) / 1000:.0f} s")


class Driving:
    """The page of a drive, and all that it is sent."""

    def __init__(self, page: Page, start: str) -> None:
        self.page = page
        self.sent: dict[int, dict[str, Any]] = {}
        page.on("websocket", self._listen)
        page.click(start)
        page.wait_for_selector("#wheel[data-holder=true][data-frame]")

    @property
    def now(self) -> dict[str, Any]:
        return self.sent[max(self.sent)]

    @property
    def at_laps(self) -> float:
        """Where the car is on the track."""
        return float(self._distances_m().argmin()) / len(self._road)

    def wanted(self) -> float:
        """The steering that brings the car to the middle of the road ahead: -1 left .. 1 right."""
        now = self.now
        ahead_m = 4 + _LOOK_AHEAD_S * max(now["speed_mph"], 0) * MPS_PER_MPH
        line = np.roll(self._road, -int(self._distances_m().argmin()), axis=0)
        way_m = np.cumsum(np.hypot(*np.diff(line, axis=0).T))
        x, y = line[1 + int(np.searchsorted(way_m, ahead_m))] - (now["x"], now["y"])
        angle = math.atan2(y, x) - now["heading_rad"]
        lock_rad = math.atan(2 * math.sin(angle) * WHEELBASE_M / math.hypot(x, y))
        return max(-1.0, min(-math.degrees(lock_rad) / MAX_STEERING_DEG, 1.0))

    def tap(self) -> None:
        """Tap an arrow key for so long that the mean steering is the wanted one."""
        steering = self.wanted()
        held_s = math.sqrt(abs(steering) * _TAP_EVERY_S / _KEY_PER_S)
        key = "ArrowLeft" if steering < 0 else "ArrowRight"
        if held_s > 0.05:
            self.page.keyboard.down(key)
            self.page.wait_for_timeout(1000 * held_s)
            self.page.keyboard.up(key)
        self.page.wait_for_timeout(1000 * (_TAP_EVERY_S - held_s))

    @contextlib.contextmanager
    def filmed(self) -> Iterator[list[Shown]]:
        """What the page shows, in the order in which it was painted; empty until the block ends."""
        shown: list[Shown] = []
        cast: list[tuple[float, bytes]] = []
        session = self.page.context.new_cdp_session(self.page)

        def keep(event: dict[str, Any]) -> None:
            cast.append((event["metadata"]["timestamp"], base64.b64decode(event["data"])))
            session.send("Page.screencastFrameAck", {"sessionId": event["sessionId"]})

        session.on("Page.screencastFrame", keep)
        session.send("Page.startScreencast", {"format": "jpeg", "quality": 95})
        yield shown
        session.send("Page.stopScreencast")
        painted = self.page.evaluate("painted")
        times_s = [time_s for time_s, *_ in painted]
        for time_s, data in cast:
            _, number, key = painted[max(int(np.searchsorted(times_s, time_s)) - 1, 0)]
            shown.append((self.sent[number]["time_s"], data, key))

    def end(self) -> None:
        self.page.keyboard.press("Escape")
        self.page.click("#confirm button[value=end]")
        self.page.wait_for_selector("#after form")

    def _listen(self, socket: WebSocket) -> None:
        socket.on("framereceived", self._receive)

    def _receive(self, message: str | bytes) -> None:
        if isinstance(message, bytes):
            frame = json.loads(message[4 : 4 + int.from_bytes(message[:4], "big")])
            self.sent[frame["frame"]] = frame
        elif (text := json.loads(message))["type"] == "hello":
            left, right = np.array(text["road"]["left"]), np.array(text["road"]["right"])
            self._road = (left + right) / 2

    def _distances_m(self) -> NDArray[np.float64]:
        distances: NDArray[np.float64] = np.hypot(*(self._road - (self.now["x"], self.now["y"])).T)
        return distances


def add_drive(film: Film, shown: list[Shown], caption: str, *, has_keys: bool) -> None:
    """Pictures at steps of simulated time."""
    kept = shown[:1]
    for picture in shown:
        if picture[0] >= kept[-1][0] + _STEP_S - 1e-6:
            kept.append(picture)
    for (time_s, data, key), (next_s, *_) in itertools.pairwise(kept):
        film.add(data, caption, next_s - time_s, key if has_keys else None)


def drive(page: Page, film: Film) -> None:
    page.fill("input[name=name]", NAME)
    driving = Driving(page, "button.main")
    page.keyboard.press("r")
    page.keyboard.press("ArrowUp")  # the car waits for the first key
    while driving.at_laps < DRIVEN_AT or driving.at_laps > 0.9:
        driving.tap()
    with driving.filmed() as shown:
        until_s = driving.now["time_s"] + FILMED_S
        while driving.now["time_s"] < until_s:
            driving.tap()
    add_drive(film, shown, "You drive: arrow keys", has_keys=True)
    while driving.now["laps"] < LAPS:
        driving.tap()
    driving.end()


def train(page: Page, film: Film) -> None:
    """Ends on the page that lets the network drive."""
    show_button(page, film, "Train on it")
    page.click("text=Train on it")
    with page.context.new_page() as curves:
        curves.set_default_timeout(_PATIENCE_MS)
        while curves.locator("#plots").count() == 0:  # the index is made first
            curves.wait_for_timeout(500)
            curves.goto(urljoin(page.url, f"/runs/{RUN}"))
        curves.wait_for_selector("#plots[data-shown]")
        shots = [curves.screenshot()]
        while page.locator("text=Let it drive").count() == 0:
            curves.wait_for_timeout(1000)
            shots.append(curves.screenshot())
    for at in np.linspace(0, len(shots) - 1, _LAPSE):
        film.add(shots[int(at)], "A network learns from it (time lapse)", 0.3)


def show_button(page: Page, film: Film, name: str) -> None:
    film.add(page.screenshot(), name, 0.8)
    page.keyboard.press("Tab")  # the focus of the keyboard is shown
    page.get_by_role("button", name=name).focus()
    film.add(page.screenshot(), name, 0.8)


def let_drive(page: Page, film: Film) -> None:
    show_button(page, film, "Let it drive")
    driving = Driving(page, "text=Let it drive")
    while driving.at_laps < NETWORK_AT or driving.at_laps > 0.9:
        page.wait_for_timeout(200)
    with driving.filmed() as shown:
        until_s = driving.now["time_s"] + FILMED_S
        while driving.now["time_s"] < until_s:
            page.wait_for_timeout(50)
    if driving.now["put_back"]:
        raise SystemExit("the network has left the road before: a picture of it would promise too much")
    add_drive(film, shown, "The network drives, where you never drove", has_keys=False)
    driving.end()


def make(browser: Browser, address: str) -> None:
    film = Film()
    # bypass_csp: wait_for_function polls by an eval in the page, which the pages' policy forbids
    context = browser.new_context(viewport=_WINDOW, color_scheme="light", bypass_csp=True)  # type: ignore[arg-type]
    context.add_init_script(_PAINTED)
    page = context.new_page()
    page.set_default_timeout(_PATIENCE_MS)
    page.goto(f"{address}/wheel")
    drive(page, film)
    train(page, film)
    let_drive(page, film)
    film.save(PICTURE)


def main() -> None:
    """Make the README's moving picture."""
    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.chdir(folder),
        serving(ProjectFolders()) as address,
        chromium() as browser,
    ):
        make(browser, address)


if __name__ == "__main__":
    tyro.cli(main)
