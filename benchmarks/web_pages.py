"""The waiting times of bc-web's pages in headless Chromium, compared with a page that only shows the pictures.

python benchmarks/web_pages.py [--sessions 1000] [--minutes 60] [--seconds 20] [--hours-of-use 1]

The mouse moves 30 times a second along the curves of a session of an hour with three cameras. The benchmark
measures the time from each move until every camera shows its picture, or that of a later move. The page for
comparison shows the same bytes, as files, in three <img>. Then ten clients request only pictures. An hour of use
is the number of pictures that an hour of scrubbing requests, as fast as they come. At the end, each page is opened
once, and its largest paint and its JavaScript are printed. On a busy machine, only processor times and the ratios
of measurements in turns are meaningful; the load is printed. Needs Playwright, Chromium, and 1.2 GB in the folder
for temporary files.
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import psutil  # type: ignore[import-untyped]  # comes with rerun-sdk
from playwright.sync_api import Browser, Page, sync_playwright

from common.car import CAMERAS
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState

RATE_HZ: Final = 10
MOVES_HZ: Final = 30  # of the mouse
CLIENTS: Final = 10
DIFFERENT: Final = 200  # pictures; each row has one of them
PROGRAM: Final = "/usr/bin/chromium"
PORT: Final = 8123
WATCH: Final = """([selector, rows, pattern]) => {
  const over = document.querySelector(selector).getBoundingClientRect();
  const moves = []; window.waits = [];
  const tolerance = rows / over.width;  // of a pixel
  document.addEventListener('mousemove', event => {
    moves.push([performance.now(), (event.clientX - over.left) / over.width * (rows - 1)]);
  }, true);
  new MutationObserver(() => {
    const shown = [...document.querySelectorAll('[data-shown]')];
    const row = Math.min(...shown.map(image => Number(new RegExp(pattern).exec(image.dataset.shown)?.[1] ?? -1)));
    while (moves.length && moves[0][1] <= row + tolerance) waits.push(performance.now() - moves.shift()[0]);
  }).observe(document.body, {subtree: true, attributes: true, attributeFilter: ['data-shown']});
}"""
PAGES: Final = (
    "/",
    "/wheel",
    "/sessions",
    "/sessions/hour",
    "/map?of=sessions/hour",
    "/index",
    "/runs",
    "/drives",
    "/jobs",
)
WEIGH: Final = """() => new Promise(done => new PerformanceObserver(list => {
  const isOwn = ({name}) => name.endsWith('.js') && !name.includes('/vendor/');
  const own = performance.getEntriesByType('resource').filter(isOwn);
  const sum = size => own.reduce((total, entry) => total + entry[size], 0);
  done([list.getEntries().at(-1).startTime, sum('decodedBodySize'), sum('encodedBodySize')]);
}).observe({type: 'largest-contentful-paint', buffered: true}))"""
STATIC_PAGE: Final = """<!doctype html><body style="margin:0">
<div id="over" style="height:300px;background:#ddd"></div><img><img><img><script>
const images = [...document.images], wanted = [], busy = [];
async function load(at) {
  busy[at] = true;
  while (wanted[at] != null) {
    const row = wanted[at]; wanted[at] = null;
    images[at].src = `/${row %% %d}.jpg?${at}.${row}`;
    try { await images[at].decode(); } catch {}
    images[at].dataset.shown = images[at].src;
  }
  busy[at] = false;
}
document.getElementById("over").addEventListener("mousemove", event => images.forEach((_, at) => {
  wanted[at] = Math.round(event.offsetX / event.target.clientWidth * (%d - 1));
  if (!busy[at]) load(at);
}));
</script>"""


def pictures() -> list[bytes]:
    """Pictures of noise of the size of the simulator's, 10 kB."""
    made = []
    for number in range(DIFFERENT):
        noise = np.random.default_rng(number).integers(0, 256, (20, 40, 3)).astype(np.uint8)
        picture = cv2.resize(noise, (320, 160), interpolation=cv2.INTER_CUBIC)
        made.append(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 60])[1].tobytes())
    return made


def write_session(path: Path, minutes: float, jpegs: list[bytes]) -> int:
    rows = int(minutes * 60 * RATE_HZ)
    with LogWriter(path, {"source": "benchmark"}) as writer:
        for row in range(rows):
            time_ns = row * 10**9 // RATE_HZ
            for camera in CAMERAS:
                writer.picture(camera, time_ns, row, jpegs[row % DIFFERENT])
            steering = float(np.sin(row / 40)) * 0.5
            writer.vehicle(time_ns, row, VehicleState(steering=steering, throttle=0.5, brake=0.0, speed_mph=20.0))
    return rows


@contextlib.contextmanager
def process(code: str, folder: Path, *arguments: str) -> Iterator[psutil.Process]:
    """Run Python code that serves on PORT. Yields its process when it answers."""
    environment = {**os.environ, "PYTHONPATH": str(Path.cwd()), "XDG_CACHE_HOME": str(folder / "cache")}
    with subprocess.Popen([sys.executable, "-c", code, *arguments], cwd=folder, env=environment) as started:
        try:
            while True:
                with contextlib.suppress(OSError):
                    get(http.client.HTTPConnection("127.0.0.1", PORT), "/static/icon.svg")
                    break
                time.sleep(0.05)
            yield psutil.Process(started.pid)
        finally:
            started.terminate()


def workbench(folder: Path) -> contextlib.AbstractContextManager[psutil.Process]:
    code = "from behavioural_cloning_toolkit import bc_web as main; main()"
    return process(code, folder, "--no-token", "--port", str(PORT))


def static_server(folder: Path) -> contextlib.AbstractContextManager[psutil.Process]:
    code = (
        "import uvicorn; from starlette.staticfiles import StaticFiles;"
        f"uvicorn.run(StaticFiles(directory='static', html=True), port={PORT}, log_level='critical')"
    )
    return process(code, folder)


def get(connection: http.client.HTTPConnection, path: str) -> bytes:
    connection.request("GET", path)
    return connection.getresponse().read()


def cpu_s(server: psutil.Process) -> float:
    times = server.cpu_times()
    return float(times.user + times.system)


def load() -> str:
    return f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"


def first_views(browser: Browser, folder: Path, sessions: int) -> None:
    for name in ("the first start", "a later start"):
        with workbench(folder) as server:
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            started_s = time.perf_counter()
            page.goto(f"http://127.0.0.1:{PORT}/sessions", timeout=300_000)
            seen_s = time.perf_counter() - started_s
            page.wait_for_selector(".session:last-child .steered img", state="attached", timeout=300_000)
            while "being read" in page.inner_text(".count"):
                time.sleep(0.05)
            print(
                f"{sessions:,} sessions, {name}: the page after {seen_s:.2f} s, all of them in it after"
                f" {time.perf_counter() - started_s:.2f} s; {cpu_s(server):.2f} s of a processor since its start,"
                f" {server.memory_info().rss / 1e6:.0f} MB; {load()}"
            )
            used_s, begun_s = cpu_s(server), time.perf_counter()
            for _ in range(5):
                page.reload(timeout=300_000)
            print(
                f"  again: the page after {(time.perf_counter() - begun_s) / 5:.2f} s,"
                f" {(cpu_s(server) - used_s) / 5:.2f} s of a processor; {load()}"
            )
            if name == "a later start":
                print(f"scrolling through them: from frame to frame {percentiles(scroll(page))}")
            page.close()


def weigh(browser: Browser, address: str) -> None:
    """The largest contentful paint of each page, and the JavaScript of our own that it loads."""
    for path in PAGES:
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(f"{address}{path}", wait_until="networkidle")
        largest_ms, *script_bytes = page.evaluate(WEIGH)
        kilobytes = " kB of JavaScript, ".join(f"{size / 1e3:.0f}" for size in script_bytes)
        print(f"{path}: painted after {largest_ms:.0f} ms; {kilobytes} kB sent")
        page.close()
    print(load())


def scroll(page: Page) -> list[float]:
    waits: list[float] = page.evaluate(
        """() => new Promise(resolve => {
            const waits = []; let before = performance.now();
            const step = now => {
                waits.push(now - before); before = now;
                scrollBy(0, 60);
                waits.length < 180 ? requestAnimationFrame(step) : resolve(waits.slice(1));
            };
            requestAnimationFrame(step);
        })"""
    )
    return waits


def scrub(page: Page, selector: str, rows: int, pattern: str, seconds: float) -> list[float]:
    """The milliseconds from each move of the mouse to its pictures."""
    box = page.locator(selector).first.bounding_box()
    assert box is not None  # noqa: S101
    page.evaluate(WATCH, [selector, rows, pattern])
    moves = int(seconds * MOVES_HZ)
    start_s = time.perf_counter()
    for move in range(moves):
        page.mouse.move(box["x"] + 2 + (box["width"] - 4) * move / moves, box["y"] + box["height"] / 2)
        time.sleep(max(0.0, start_s + (move + 1) / MOVES_HZ - time.perf_counter()))
    time.sleep(1)
    waits: list[float] = page.evaluate("window.waits")
    if len(waits) < 0.98 * moves:
        print(f"  of {moves} moves, {moves - len(waits)} were never followed by their pictures")
    return waits


def clients(rows: int, seconds: float) -> list[float]:
    """The milliseconds for each picture, with ten clients that each request thirty a second."""
    waits: list[float] = []

    def ask(number: int) -> None:
        chance = random.Random(number)
        connection = http.client.HTTPConnection("127.0.0.1", PORT)
        for at in range(int(seconds * MOVES_HZ)):
            begun_s = time.perf_counter()
            get(connection, f"/sessions/hour/pictures/center/{chance.randrange(rows)}")
            waits.append((time.perf_counter() - begun_s) * 1e3)
            time.sleep(max(0.0, start_s + (at + 1) / MOVES_HZ - time.perf_counter()))

    start_s = time.perf_counter()
    threads = [threading.Thread(target=ask, args=(number,)) for number in range(CLIENTS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return waits


def hours_of_use(server: psutil.Process, rows: int, hours: float) -> None:
    """Request the pictures of three cameras for `hours` of scrubbing, and print processor time and memory."""
    pictures = int(hours * 3600 * MOVES_HZ) * len(CAMERAS)
    connection = http.client.HTTPConnection("127.0.0.1", PORT)
    memory_mb, used_s = [server.memory_info().rss / 1e6], cpu_s(server)
    for at in range(pictures):
        camera, row = CAMERAS[at % len(CAMERAS)], at * 7919 // len(CAMERAS) % rows
        get(connection, f"/sessions/hour/pictures/{camera}/{row}")
        if (at + 1) % max(1, pictures // 5) == 0:
            memory_mb.append(server.memory_info().rss / 1e6)
    print(
        f"{pictures:,} pictures, {hours:g} h of scrubbing: {(cpu_s(server) - used_s) / pictures * 1e3:.2f} ms of a"
        f" processor each; memory {', '.join(f'{size_mb:.0f}' for size_mb in memory_mb)} MB; {load()}"
    )


def percentiles(waits: list[float]) -> str:
    median, p95, p99 = np.percentile(waits, [50, 95, 99])
    return f"{median:.1f} ms, p95 {p95:.1f}, p99 {p99:.1f}"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--sessions", type=int, default=1000)
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--hours-of-use", type=float, default=1)
    asked = parser.parse_args()
    jpegs = pictures()
    flags = ["--no-sandbox"] if os.name == "posix" and os.geteuid() == 0 else []
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        browser = playwright.chromium.launch(executable_path=PROGRAM, args=flags)
        write_session(folder / "short.mcap", 0.5, jpegs)
        many = folder / "many"
        (many / "sessions").mkdir(parents=True)
        for number in range(asked.sessions):
            os.link(folder / "short.mcap", many / "sessions" / f"s{number:04}.mcap")
        first_views(browser, many, asked.sessions)
        rows = write_session(folder / "sessions" / "hour.mcap", asked.minutes, jpegs)
        (folder / "static" / "static").mkdir(parents=True)
        (folder / "static" / "static" / "icon.svg").write_text("<svg/>")
        (folder / "static" / "index.html").write_text(STATIC_PAGE % (DIFFERENT, rows))
        for number, jpeg in enumerate(jpegs):
            (folder / "static" / f"{number}.jpg").write_bytes(jpeg)
        for turn in range(2):
            with workbench(folder) as server:
                page = browser.new_page(viewport={"width": 1280, "height": 800})
                started_s = time.perf_counter()
                page.goto(f"http://127.0.0.1:{PORT}/sessions/hour")
                page.wait_for_selector("#session[data-ready]", timeout=300_000)
                page.wait_for_selector("figure[data-shown]")
                opened_s = time.perf_counter() - started_s
                memory_mb = [server.memory_info().rss / 1e6]
                used_s = cpu_s(server)
                waits = scrub(page, "#curves .u-over", rows, r"pictures/\w+/(\d+)", asked.seconds)
                memory_mb.append(server.memory_info().rss / 1e6)
                workbench_waits = waits
                print(
                    f"{rows:,} rows: opened in {opened_s:.2f} s; from a move to its pictures {percentiles(waits)};"
                    f" {(cpu_s(server) - used_s) / asked.seconds:.2f} of a processor; {load()}"
                )
                page.close()
                waits = clients(rows, asked.seconds / 2)
                print(f"{CLIENTS} clients at once: a picture in {percentiles(waits)}; {load()}")
                memory_mb.append(server.memory_info().rss / 1e6)
                if turn:
                    weigh(browser, f"http://127.0.0.1:{PORT}")
                    hours_of_use(server, rows, asked.hours_of_use)
                shown_mb = ", ".join(f"{size_mb:.0f} MB" for size_mb in memory_mb)
                print(f"memory when opened, after scrubbing, after the clients: {shown_mb}")
            with static_server(folder) as server:
                page = browser.new_page(viewport={"width": 1280, "height": 800})
                page.goto(f"http://127.0.0.1:{PORT}/")
                used_s = cpu_s(server)
                waits = scrub(page, "#over", rows, r"\.(\d+)$", asked.seconds)
                ratios = np.percentile(workbench_waits, [50, 95]) / np.percentile(waits, [50, 95])
                print(
                    f"a static page of the same pictures: {percentiles(waits)};"
                    f" {(cpu_s(server) - used_s) / asked.seconds:.2f} of a processor; {load()};"
                    f" the workbench takes {ratios[0]:.1f} times as long, p95 {ratios[1]:.1f}"
                )
                page.close()
        browser.close()


if __name__ == "__main__":
    main()
