"""The web viewer in a real browser: Chromium without a window opens what `bc-play --web` prints, and shows frames.

It needs no graphics card: without one, the browser draws in software, which takes seconds; so the window is small.
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import psutil  # type: ignore[import-untyped]  # comes with rerun-sdk
import pytest
from numpy.typing import NDArray

from common.car import Camera
from tests.helpers.driving import command, environment
from tests.helpers.logs import write_log
from tests.helpers.pages import window_of
from tests.helpers.ports import free_ports
from tests.helpers.rrd import listening
from tests.helpers.waiting import wait_until

if TYPE_CHECKING:
    from playwright.sync_api import Browser

RED, GREEN = (0, 0, 255), (0, 255, 0)
MIN_PIXELS = 2000


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
            process = psutil.Process(play.pid)
            # it says so a moment before
            wait_until(lambda: any(web_port in listening(child) for child in process.children(recursive=True)))
            yield address
        finally:
            play.send_signal(signal.SIGINT)


def places_of(picture: NDArray[np.uint8], color: tuple[int, int, int]) -> NDArray[np.int64]:
    """Rows and columns (N, 2) of the pixels of a colour."""
    return np.argwhere(np.abs(picture.astype(int) - color).max(axis=2) < 40)


def test_the_page_shows_the_pictures_of_the_log(browser: Browser, tmp_path: Path) -> None:
    log = write_log(tmp_path / "x.mcap", [0.1 * i for i in range(10)], half_red_half_green, cameras=["center"])
    with served(log) as address, window_of(browser, 640, 480) as page:
        page.add_init_script("console.debug = () => {}")  # tens of thousands of lines about its shaders
        page.goto(address)

        def shown() -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
            picture = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
            assert picture is not None
            red, green = (places_of(picture.astype(np.uint8), color) for color in (RED, GREEN))
            return (red, green) if min(len(red), len(green)) > MIN_PIXELS else None

        colours = wait_until(shown)
    assert colours is not None
    red, green = colours
    # whole, and twice as wide as high
    height, width = np.ptp(red[:, 0]) + 1, np.ptp(red[:, 1]) + 1
    assert len(red) > 0.8 * height * width  # something may be drawn over it
    assert height == pytest.approx(width, abs=4)
    assert len(green) == pytest.approx(len(red), rel=0.05)
    assert red[:, 1].max() < green[:, 1].min() + 3
