"""A person at the wheel, in Chromium: the delay from a key to the picture that shows its effect; takeovers; an
hour.

python studies/at_wheel.py [--seconds 120] [--json at_wheel.json]
python studies/at_wheel.py --takeovers 1000
python studies/at_wheel.py --minutes 60

The first command drives the built-in simulator with real key events at random moments, to the side that keeps the
car on the road, while it records three cameras at 10 rows a second. It measures the time from each key event to
the end of the animation frame with the first picture that shows the new steering, and the time between two such
frames. Before that, it measures the renderer alone on one core. The second command supervises a network through
the wheel's socket: between a takeover and its hand back, no answer of the network may be sent. The third command
drives by keys for an hour, and watches memory, files and rows. Timings need an otherwise idle machine; the load is
printed.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import struct
import sys
import tempfile
import time
from collections import Counter
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import psutil  # type: ignore[import-untyped]  # comes with rerun-sdk
from drive_page import PATIENCE_S, DrivePage, chromium, running, wait_for, wheel_of, workbench
from scripted_player import Player
from toolkit_command import output_of
from websockets.sync.client import ClientConnection, connect

from common.car import CAMERAS
from recorder import Log
from recorder.bc_pb2 import PilotCommand
from recorder.teleop.wheel import OpenWheel
from simulator.driving.person import KeyboardDriver
from simulator.driving.simulation import Simulation

TRACK: Final = "lake"
EYE_SCALES: Final = (2.0, 1.5, 1.0)
BARS_MS: Final = {"delay p50": 60.0, "delay p99": 100.0, "between pictures p99": 80.0}
MIN_PICTURE_HZ: Final = 20.0
WATCH: Final = """async () => {
  const { delays } = await import(document.querySelector('script[src$="/wheel/main.js"]').src);
  const { sent, painted, forget } = delays, channel = new MessageChannel(), shown = [];
  let waiting = [];
  window.measured = { delays: [], pictures: [], forgotten: 0 };
  channel.port1.onmessage = () => {  // the animation frame is over
    const number = shown.shift(), now = performance.now();
    measured.pictures.push(now);
    while (waiting.length && waiting[0][0] <= number) measured.delays.push(now - waiting.shift()[1]);
  };
  delays.sent = (number, event_ms) => { sent.call(delays, number, event_ms); waiting.push([number, event_ms]); };
  delays.painted = number => { painted.call(delays, number); shown.push(number); channel.port2.postMessage(0); };
  delays.forget = () => { forget.call(delays); measured.forgotten += waiting.length; waiting = []; };
}"""
PRESS_S: Final = (0.05, 0.3)
PAUSE_S: Final = 0.25  # on average
TAKEN: Final = 0.625  # steering that the network does not answer, to recognise the person's


def renderer_alone(seconds: float) -> dict[str, float]:
    """The pictures of each size for the page, and the rows of three cameras, that one core renders in a second."""
    cv2.setNumThreads(1)
    simulation = Simulation(TRACK)
    line = simulation.track.line
    rates = {}
    for what, scale, cameras in [
        *((f"eye {320 * scale:.0f}x{160 * scale:.0f}", scale, CAMERAS[:1]) for scale in EYE_SCALES),
        ("rows of three cameras", 1.0, CAMERAS),
    ]:
        begin_s, made = time.perf_counter(), 0
        while (passed_s := time.perf_counter() - begin_s) < seconds:
            simulation.course.start(made * 7.0 % line.length_m)
            for camera in cameras:
                simulation.jpeg(camera, scale=scale)
            made += 1
        rates[what] = round(made / passed_s, 1)
    return rates


def delays(folder: Path, seconds: float) -> dict[str, Any]:
    """Press keys at random moments while a drive is recorded. Returns the measurements."""
    alone = renderer_alone(min(3.0, seconds / 4))
    words = ("me", "delays", "--no-page", "--track", TRACK)
    with (
        workbench(folder) as (server, address),
        running(folder, "bc-record", *words) as drive,
        chromium() as browser,
    ):
        page = DrivePage(browser, address, wheel_of(folder, drive))
        player, chance = Player(page, "keys", 0), random.Random(0)
        driver = KeyboardDriver(player.eyes.map.line, 10.0)
        page.record()
        wait_for(lambda: page.see().speed_mph > 8 or None, "the car to drive")
        page.page.evaluate(WATCH)
        used_s = [cpu_s(drive), cpu_s(server)]
        begin_s, first_rows, paces, widths = time.monotonic(), page.see().rows, [], Counter[int]()
        presses, look_s, told_s = 0, 0.0, begin_s
        while (now_s := time.monotonic()) < begin_s + seconds:
            sight = player.look()
            wanted, _ = driver.wish.control(sight.course)
            key = "ArrowLeft" if wanted < 0 else "ArrowRight"
            page.page.keyboard.down(key)
            time.sleep(chance.uniform(*PRESS_S))
            page.page.keyboard.up(key)
            presses += 1
            time.sleep(chance.expovariate(1 / PAUSE_S))
            if now_s - look_s >= 1.0:
                look_s = now_s
                paces.append(player.seen.pace)
                widths[page.page.evaluate("document.getElementById('picture').width")] += 1
            if now_s - told_s >= 10:
                told_s = now_s
                progress(f"{now_s - begin_s:.0f} of {seconds:.0f} s, {presses} presses")
        passed_s = time.monotonic() - begin_s
        measured = page.page.evaluate("measured")
        seen = page.see()
        processes = zip((drive, server), used_s, strict=True)
        cpus = [(cpu_s(process) - before_s) / passed_s for process, before_s in processes]
        page.end()
    between = np.diff(measured["pictures"])
    result: dict[str, Any] = {
        "load": load(),
        "presses": presses,
        "delays": len(measured["delays"]),
        "delay p50": percentile(measured["delays"], 50),
        "delay p99": percentile(measured["delays"], 99),
        "delay max": percentile(measured["delays"], 100),
        "between pictures p50": percentile(between, 50),
        "between pictures p99": percentile(between, 99),
        "between pictures max": percentile(between, 100),
        "pictures a second": round(len(between) / passed_s, 1),
        "picture widths": dict(widths),
        "pace": round(float(np.mean(paces)), 3),
        "pace, least": min(paces),
        "rows a second": round((seen.rows - first_rows) / passed_s, 2),
        "put back": seen.put_back,
        "processors of the drive, of bc-web": [round(cpu, 2) for cpu in cpus],
        "renderer alone, a second": alone,
        "delays_ms": [round(delay, 1) for delay in measured["delays"]],
    }
    is_within = all(result[name] <= bar for name, bar in BARS_MS.items())
    result["is within the bars"] = bool(is_within and result["pictures a second"] >= MIN_PICTURE_HZ)
    return result


class Socket:
    """The wheel's socket, as bc-web uses it."""

    def __init__(self, connection: ClientConnection) -> None:
        self._socket = connection
        self._number = 0

    def send(self, kind: str, **values: object) -> None:
        self._socket.send(json.dumps({"type": kind, **values}))

    def steer(self, steering: float, *, is_touching: bool) -> int:
        self._number += 1
        control = {"throttle": 0.0, "hold_mph": 10.0, "device": "keyboard", "touching": is_touching}
        self.send("control", number=self._number, time_ms=0.0, steering=steering, **control)
        return self._number

    def frame(self) -> dict[str, Any]:
        """The state of the next frame."""
        while isinstance(data := self._socket.recv(PATIENCE_S), str):
            pass
        (length,) = struct.unpack_from(">I", data)
        state: dict[str, Any] = json.loads(data[4 : 4 + length])
        self.send("got", frame=state["frame"])
        return state


def socket_of(wheel: OpenWheel) -> ClientConnection:
    headers = {"Authorization": f"Bearer {wheel.token}"}
    address = f"ws://127.0.0.1:{wheel.port}"
    return connect(address, additional_headers=headers, compression=None, max_size=1 << 24)


def takeovers(folder: Path, times: int) -> dict[str, Any]:
    """Take over from a network at random moments, and hand back. Returns the counts."""
    progress("training a network to take over from")
    output_of(folder, "bc-record", "short", "--track", TRACK, "--laps", "0.05")
    output_of(folder, "bc-train", "--name", "short", "--epochs", "1")
    log, chance = folder / "drives" / "takeovers.mcap", random.Random(0)
    words = ["--simulator", TRACK, "--laps", "1000", "--takeover", "me", "--no-page", "--viewer", "off"]
    after, held = Counter[str](), 0
    with (
        running(folder, "bc-drive", "short", *words, "--log", log) as drive,
        socket_of(wheel_of(folder, drive)) as connection,
    ):
        page = Socket(connection)
        told_s = begin_s = time.monotonic()
        for made in range(times):
            for _ in range(chance.randint(1, 3)):
                page.frame()
            time.sleep(chance.uniform(0, 0.1))  # at any moment of the network's step
            number = page.steer(TAKEN, is_touching=True)
            while (state := page.frame())["control"] < number:
                pass
            after[state["drives"]] += 1
            for _ in range(chance.randint(0, 2)):
                after[page.frame()["drives"]] += 1
            page.steer(0.0, is_touching=False)
            page.send("hand_back")
            while (state := page.frame())["drives"] != "pilot":
                held += 1
            if time.monotonic() - told_s >= 10:
                told_s = time.monotonic()
                left_s = (told_s - begin_s) / (made + 1) * (times - made - 1)
                progress(f"{made + 1} of {times} takeovers, about {left_s:.0f} s left")
        page.send("end")
        with contextlib.suppress(psutil.TimeoutExpired):
            drive.wait(PATIENCE_S)
    with Log(log) as opened:
        drivers = [command.driver for _, command in opened.commands()]
    stretches = [driver for driver, _ in groupby(drivers)]
    human = stretches.count(PilotCommand.HUMAN)
    return {
        "load": load(),
        "takeovers": times,
        "stretches of a person in the log": human,  # more than takeovers: the network has answered within one
        "frames after a takeover, by who drove": dict(after),
        "rows": len(drivers),
        "rows by a person": sum(driver == PilotCommand.HUMAN for driver in drivers),
        "answers of the network after a takeover": human - times + sum(after.values()) - after["human"],
    }


def soak(folder: Path, minutes: float, keep: Path) -> dict[str, Any]:
    """Drive by keys for `minutes`, and write the samples to `keep` as they come. Returns the measurements."""
    words = ("me", "soak", "--no-page", "--track", TRACK)
    samples: list[dict[str, float]] = []
    with (
        workbench(folder) as (server, address),
        running(folder, "bc-record", *words) as drive,
        chromium() as browser,
    ):
        page = DrivePage(browser, address, wheel_of(folder, drive))
        player = Player(page, "keys", 0)
        page.record()
        begin_s, every_s = time.monotonic(), max(1.0, 60 * minutes / 360)
        while (now_s := time.monotonic()) < begin_s + 60 * minutes:
            player.step()
            if now_s - begin_s < len(samples) * every_s:
                continue
            seen = player.seen
            samples.append({"minute": round((now_s - begin_s) / 60, 2), "rows": seen.rows, "pace": seen.pace})
            for name, process in (("drive", drive), ("bc-web", server)):
                samples[-1][f"{name} MB"] = round(process.memory_info().rss / 1e6, 1)
                samples[-1][f"{name} files"] = process.num_fds()
            keep.write_text(json.dumps({"samples": samples}))
            if len(samples) % 12 == 1:
                progress(" ".join(f"{name} {value}" for name, value in samples[-1].items()))
        player.hands.let_go()
        shown = page.see()
        page.end()
        ended_rows = page.see().rows
        after_end = server.num_fds()
    log = folder / "sessions" / "soak.mcap"
    with Log(log) as opened:
        rows = len(opened.vehicle()["row"])
        pictures = {camera: opened.counts[f"/camera/{camera}"] for camera in CAMERAS}
    warm = samples[len(samples) // 6 :]  # after everything that is loaded once
    result: dict[str, Any] = {
        "load": load(),
        "minutes": minutes,
        "rows in the log": rows,
        "rows shown": ended_rows,
    }
    result |= {"rows shown before the end": shown.rows, "pictures": pictures, "put back": shown.put_back}
    for name in ("drive MB", "drive files", "bc-web MB", "bc-web files"):
        values = [sample[name] for sample in warm]
        hours = [sample["minute"] / 60 for sample in warm]
        slope = float(np.polyfit(hours, values, 1)[0]) if len(values) > 2 else 0.0
        result[name] = {"first": values[0], "last": values[-1], "most": max(values), "an hour": round(slope, 1)}
    result["bc-web files after the end"] = after_end
    result["bc-log check"] = output_of(folder, "bc-log", "check", log).strip().splitlines()[-1]
    result["is whole"] = rows in (shown.rows, ended_rows) and set(pictures.values()) == {rows}
    return result | {"samples": samples}


def cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def percentile(values: Any, at: float) -> float:
    return round(float(np.percentile(values, at)), 1) if len(values) else float("nan")


def load() -> str:
    return f"{os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"


def progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def print_table(title: str, result: dict[str, Any]) -> None:
    print(f"| {title} | |\n|---|---|")
    for name, value in result.items():
        bar = f" (at most {BARS_MS[name]:.0f})" if name in BARS_MS else ""
        if name not in ("delays_ms", "samples"):
            shown = (
                ", ".join(f"{key}: {part}" for key, part in value.items()) if isinstance(value, dict) else value
            )
            print(f"| {name}{bar} | {shown} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=120, help="length of the key presses")
    parser.add_argument(
        "--takeovers", type=int, default=0, help="instead, supervise a network with this many takeovers"
    )
    parser.add_argument("--minutes", type=float, default=0, help="instead, drive for this time")
    parser.add_argument("--json", type=Path, default=Path("at_wheel.json"))
    asked = parser.parse_args()
    keep: Path = asked.json.absolute()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["BC_CACHE"] = str(folder / "cache")
        if asked.takeovers:
            title, result = "takeovers", takeovers(folder, asked.takeovers)
        elif asked.minutes:
            title, result = "a long drive", soak(folder, asked.minutes, keep)
        else:
            title, result = "delays, ms", delays(folder, asked.seconds)
    keep.write_text(json.dumps(result, indent=1))
    print_table(title, result)


if __name__ == "__main__":
    main()
