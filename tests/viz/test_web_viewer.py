"""The web viewer in a real browser: Chromium without a window opens what `bc-play --web` prints, and shows frames.

Needs a Chromium or Chrome on the machine (Debian: `apt install chromium`), and no graphics card: without one, it
draws in software, which takes seconds. It is told what to do in its DevTools protocol,
https://chromedevtools.github.io/devtools-protocol/.
"""

from __future__ import annotations

import base64
import contextlib
import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import websocket
from numpy.typing import NDArray

from common.car import Camera
from driving import PATIENCE_S, command, environment
from logs import write_log
from rrd import free_ports

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
PROGRAM = next(filter(None, map(shutil.which, PROGRAMS)), "")
RED, GREEN = (0, 0, 255), (0, 255, 0)

pytestmark = pytest.mark.skipif(
    not PROGRAM or os.name != "posix",
    reason="the web viewer was not tried in a browser: no Chromium here (Debian: apt install chromium)",
)


def half_red_half_green(camera: Camera, row: int) -> bytes:
    picture = np.zeros((160, 320, 3), np.uint8)
    picture[:, :160], picture[:, 160:] = RED, GREEN
    ok, encoded = cv2.imencode(".jpg", picture)
    assert ok
    return encoded.tobytes()


@contextlib.contextmanager
def served(log: Path) -> Iterator[str]:
    """The address that `bc-play --web` prints, while it runs."""
    web_port, port = free_ports(2)
    line = command("bc-play", log, "--web", "--web-port", web_port, "--port", port)
    with subprocess.Popen(line, env=environment(), stdout=subprocess.PIPE, text=True) as play:
        try:
            assert play.stdout is not None
            address = play.stdout.readline().strip()
            assert address.startswith("http://127.0.0.1:")
            yield address
        finally:
            play.send_signal(signal.SIGINT)


class Browser:
    """Chromium without a window, with one page open; it reaches this machine only."""

    def __init__(self, profile: Path) -> None:
        flags = [
            "--headless=new",
            "--remote-debugging-port=0",
            "--remote-allow-origins=*",
            f"--user-data-dir={profile}",
            "--no-first-run",
            "--window-size=800,640",
            "--enable-unsafe-swiftshader",  # newer ones draw WebGL in software only if they are told to
            "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
        ]
        if os.geteuid() == 0:
            flags.append("--no-sandbox")  # it refuses to run as root with one
        self._process = subprocess.Popen(
            [PROGRAM, *flags, "about:blank"], stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        self._numbers = itertools.count(1)
        self._session = ""

    def __enter__(self) -> Browser:
        assert self._process.stderr is not None
        said = next((line for line in self._process.stderr if "DevTools listening on" in line), "")
        found = re.search(r"ws://\S+", said)
        if found is None:
            self._end()
            pytest.fail("Chromium does not start")
        self._socket = websocket.create_connection(found[0], timeout=PATIENCE_S)
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        self._end()

    def _end(self) -> None:
        with contextlib.suppress(ProcessLookupError):  # with its own children
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.communicate()

    def call(self, method: str, **parameters: object) -> Any:
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        self._socket.send(json.dumps(message))
        answer = self._wait_for("id", number)
        assert "result" in answer, answer
        return answer["result"]

    def open(self, address: str) -> None:
        """Return when the page is there, which need not have drawn anything yet."""
        self.call("Page.enable")
        self.call("Page.navigate", url=address)
        self._wait_for("method", "Page.loadEventFired")

    def screenshot(self) -> NDArray[np.uint8]:
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        return picture.astype(np.uint8)

    def _wait_for(self, key: str, value: object) -> Any:
        """The next message of the browser in which `key` is `value`; those before it are dropped."""
        while True:
            message = json.loads(self._socket.recv())
            if message.get(key) == value:
                return message


def places_of(picture: NDArray[np.uint8], color: tuple[int, int, int]) -> NDArray[np.int64]:
    """Rows and columns (N, 2) of the pixels of a colour."""
    return np.argwhere(np.abs(picture.astype(int) - color).max(axis=2) < 40)


def test_the_page_shows_the_pictures_of_the_log(tmp_path: Path) -> None:
    log = write_log(tmp_path / "x.mcap", [0.1 * i for i in range(10)], half_red_half_green, cameras=["center"])
    with served(log) as address, Browser(tmp_path / "profile") as browser:
        browser.open(address)
        deadline_s = time.monotonic() + 2 * PATIENCE_S
        while True:
            page = browser.screenshot()
            red, green = places_of(page, RED), places_of(page, GREEN)
            if min(len(red), len(green)) > 5000 or time.monotonic() > deadline_s:
                break
            time.sleep(0.2)
    cv2.imwrite(str(tmp_path / "page.png"), page)
    assert min(len(red), len(green)) > 5000, f"no picture of the log on the page: see {tmp_path / 'page.png'}"
    # whole, and twice as wide as high
    height, width = np.ptp(red[:, 0]) + 1, np.ptp(red[:, 1]) + 1
    assert len(red) > 0.8 * height * width  # something may be drawn over it
    assert height == pytest.approx(width, abs=4)
    assert len(green) == pytest.approx(len(red), rel=0.05)
    assert red[:, 1].max() < green[:, 1].min() + 3
