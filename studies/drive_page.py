"""Shared by the studies of a person at the wheel: background commands, Chromium, and the page of a drive."""

from __future__ import annotations

import contextlib
import http.client
import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
import psutil  # type: ignore[import-untyped]  # comes with rerun-sdk
from playwright.sync_api import Browser, Page, sync_playwright
from toolkit_command import command_line, environment

from recorder.teleop.wheel import OpenWheel, open_wheels
from simulator.roads.centreline import Centreline, Floats

PATIENCE_S: Final = 120.0
PROGRAMS: Final = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
PADS: Final = """window.stick = 0;
navigator.getGamepads = () => [{id: 'virtual', index: 0, connected: true, mapping: 'standard',
  axes: [stick, 0, 0, 0], buttons: Array.from({length: 17}, () => ({value: 0, pressed: false}))}];"""
ROAD: Final = """() => document.querySelector('#map .road')?.getAttribute('d')"""
SHOWN: Final = """() => {
  const text = id => document.getElementById(id).textContent;
  return {
    frame: Number(document.getElementById('wheel').dataset.frame),
    car: document.querySelector('#map .car')?.getAttribute('transform') ?? '',
    speed: text('speed'), rows: text('rows'), laps: text('laps'), put_back: text('put-back'), pace: text('pace'),
    drives: document.getElementById('driver').dataset.by ?? '', takeovers: text('takeovers'),
    is_recording: document.getElementById('recording').classList.contains('on'),
    is_ended: !document.getElementById('ended').hidden,
  };
}"""


T = TypeVar("T")


@contextlib.contextmanager
def running(folder: Path, name: str, *words: object) -> Iterator[psutil.Process]:
    """Run a command in `folder` during the block, then end it by Ctrl-C. Its output goes to output/."""
    (folder / "output").mkdir(parents=True, exist_ok=True)
    with (folder / "output" / f"{name}-{time.time_ns()}.txt").open("w") as output:
        line = command_line(name, *words)
        with subprocess.Popen(line, cwd=folder, env=environment(), stdout=output, stderr=output) as started:
            try:
                yield psutil.Process(started.pid)
            finally:
                if started.poll() is None:
                    started.send_signal(signal.SIGINT)
                try:
                    started.wait(PATIENCE_S)
                except subprocess.TimeoutExpired:
                    started.kill()


def wait_for(look: Callable[[], T | None], what: str, process: psutil.Process | None = None) -> T:
    """Wait until `look` returns a value other than None, and return it. Raises RuntimeError after `PATIENCE_S`."""
    end_s = time.monotonic() + PATIENCE_S
    while (result := look()) is None:
        ended = process is not None and process.status() == psutil.STATUS_ZOMBIE
        if ended or time.monotonic() > end_s:
            raise RuntimeError(f"waited in vain for {what}; see the folder output/")
        time.sleep(0.05)
    return result


@contextlib.contextmanager
def workbench(folder: Path) -> Iterator[tuple[psutil.Process, str]]:
    """Run bc-web in `folder`. Yields its process and its address."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]

    def answers() -> bool | None:
        with contextlib.suppress(OSError):
            http.client.HTTPConnection("127.0.0.1", port, timeout=5).request("GET", "/static/icon.svg")
            return True
        return None

    with running(folder, "bc-web", "--no-token", "--port", port) as server:
        wait_for(answers, "bc-web", server)
        yield server, f"http://127.0.0.1:{port}"


def wheel_of(folder: Path, process: psutil.Process) -> OpenWheel:
    """The wheel of the drive in `folder`."""
    return wait_for(lambda: next(iter(open_wheels(folder)), None), "the wheel of the drive", process)


@contextlib.contextmanager
def chromium() -> Iterator[Browser]:
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    flags = ["--no-sandbox"] if os.name == "posix" and os.geteuid() == 0 else []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=flags)
        try:
            yield browser
        finally:
            browser.close()


@dataclass(frozen=True)
class Seen:
    """The values that a page shows at one moment."""

    frame: int
    x_m: float
    y_m: float
    heading_rad: float
    speed_mph: float
    rows: int
    laps: float
    put_back: int
    takeovers: int
    pace: float
    drives: str
    is_recording: bool
    is_ended: bool


class DrivePage:
    """The page of a drive in Chromium. It returns only values that the page shows."""

    def __init__(self, browser: Browser, address: str, wheel: OpenWheel) -> None:
        self.page: Page = browser.new_page(viewport={"width": 1280, "height": 800})
        self.page.add_init_script(PADS)
        self.page.goto(f"{address}/wheel/{wheel.key}")
        self.page.wait_for_selector("#wheel[data-holder=true][data-frame]", timeout=PATIENCE_S * 1000)

    def road(self) -> Floats:
        """The middle of the map's road, (N, 3) m. The map shows no height: it is 0."""
        rings = str(self.page.evaluate(ROAD)).removeprefix("M").split("M")
        left, right = (
            np.array([[float(number) for number in point.split(",")] for point in ring.rstrip("Z").split("L")])
            for ring in rings
        )
        middle = (left + right) / 2 * (1, -1)  # in pictures, y points down
        self.half_width_m = np.hypot(*(left - right).T) / 2
        return np.column_stack([middle, np.zeros(len(middle))])

    def see(self) -> Seen:
        shown: dict[str, Any] = self.page.evaluate(SHOWN)
        words = shown["car"].replace("(", " ").replace(",", " ").replace(")", " ").split()
        x, y, turn = (float(words[at]) for at in (1, 2, 4)) if words else (np.nan, np.nan, np.nan)
        pace = [float(word) / 100 for word in shown["pace"].split() if word.isdigit()]
        return Seen(
            shown["frame"],
            x,
            -y,
            -float(np.deg2rad(turn)),
            float(shown["speed"]),
            int(shown["rows"].split()[0].replace(",", "")),
            float(shown["laps"]) if shown["laps"] != "-" else 0.0,
            int(shown["put_back"]),
            int(shown["takeovers"]),
            pace[0] if pace else 1.0,
            shown["drives"],
            shown["is_recording"],
            shown["is_ended"],
        )

    def record(self) -> None:
        self.page.keyboard.press("r")
        wait_for(lambda: self.see().is_recording or None, "the recording to begin")

    def end(self) -> None:
        """End the drive with the page's keys and buttons."""
        if not self.see().is_ended:
            self.page.keyboard.press("Escape")
            self.page.click("#confirm button[value=end]")
            wait_for(lambda: self.see().is_ended or None, "the end of the drive")


class RoadMap:
    """The road of the map, to locate the car on it."""

    def __init__(self, page: DrivePage) -> None:
        self.line = Centreline(page.road())
        grid = np.linspace(0, len(page.half_width_m), len(self.line.points_m), endpoint=False)
        self.half_width_m = np.interp(grid, np.arange(len(page.half_width_m)), page.half_width_m)

    def arc_m(self, seen: Seen) -> float:
        """The car's position along the road in m."""
        distance = np.hypot(*(self.line.points_m[:, :2] - (seen.x_m, seen.y_m)).T)
        nearest = int(distance.argmin())
        return float(nearest * self.line.step_m)
