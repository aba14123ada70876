"""The memory of bc-web with a project, used as a person would, in several rounds.

python benchmarks/web_memory.py PROJECT

PROJECT has sessions/, index/ and runs/. A round requests every kind of page once or several times. After each
kind, the process's own memory (USS) is printed; it must not grow from round to round.
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

import psutil  # type: ignore[import-untyped]  # comes with rerun-sdk

PORT: Final = 8124
CAMERAS: Final = "center", "left", "right"
ROUNDS: Final = 4
PICTURES: Final = 2000  # in a round
AT_ONCE: Final = 6  # connections of a browser
DONE: Final = re.compile(rb'"about": ?[{t]|"is_done": ?true|"problem": ?"[^"]')


def ask(path: str, method: str = "GET") -> bytes:
    connection = http.client.HTTPConnection("127.0.0.1", PORT, timeout=600)
    try:
        connection.request(method, path, headers={"Accept-Encoding": "gzip"})
        answer = connection.getresponse()
        body = answer.read()
        if answer.status >= 400:
            print(f"  {path}: {answer.status} {body[:200]!r}")
        return body
    finally:
        connection.close()


def plain(path: str, method: str = "GET") -> bytes:
    connection = http.client.HTTPConnection("127.0.0.1", PORT, timeout=600)
    try:
        connection.request(method, path)
        return connection.getresponse().read()
    finally:
        connection.close()


def keys(page: str, kind: str) -> list[str]:
    return sorted(set(re.findall(rf'href="/{kind}/([^"/?#]+)"', plain(page).decode())))


def wait_for(path: str) -> None:
    while not DONE.search(plain(path)):
        time.sleep(0.2)


def uses() -> dict[str, Callable[[], object]]:
    """The actions of a person, by name. Each is done once a round."""
    while b"being read" in plain("/sessions"):
        time.sleep(0.2)
    pages = ["/sessions", "/index", "/runs", "/drives", "/jobs"]
    logs, runs = keys("/sessions", "sessions"), keys("/runs", "runs")
    log, run = logs[0], runs[0] if runs else ""

    def at_once(paths: Iterator[str] | list[str]) -> None:
        with ThreadPoolExecutor(AT_ONCE) as pool:
            list(pool.map(ask, paths))

    def fingerprint(log: str) -> str:
        return str(json.loads(plain(f"/sessions/{log}/state"))["fingerprint"])

    def predict() -> None:
        for name in logs[:2]:
            path = f"/sessions/{name}/predictions/{run}?log={fingerprint(name)}"
            plain(path, "POST")
            wait_for(path)

    def look() -> None:
        for name in logs[:2]:
            plain(f"/sessions/{name}/look", "POST")
            wait_for(f"/sessions/{name}/look")

    def rerun() -> None:
        """Read the viewer's files, 40 MB, and the recording, as the viewer's frame does, while the request for its
        log is open."""
        holding = http.client.HTTPConnection("127.0.0.1", PORT, timeout=600)
        holding.request("POST", f"/sessions/{log}/rerun")
        for line in (answer := holding.getresponse()):
            if b'"frame"' in line:
                break
        for path in ("files/re_viewer.js", "files/re_viewer_bg.wasm", f"{json.loads(line)['frame'][7:]}/log.rrd"):
            ask(f"/rerun/{path}")
        answer.close()
        holding.close()

    requests: dict[str, Callable[[], object]] = {
        "lists": lambda: [ask(path) for path in pages * 5],
        "strips, sketches": lambda: at_once(
            [f"/sessions/{name}/{file}" for name in logs for file in ("strip.jpg", "steering.svg")]
        ),
        "session pages": lambda: at_once(
            [f"/sessions/{name}{part}" for name in logs for part in ("", "/state", "/rows", "/tags", "/links")]
        ),
        "pictures": lambda: at_once(
            [
                f"/sessions/{logs[at % len(logs)]}/pictures/{CAMERAS[at % 3]}/{at * 7919 % 1000}"
                for at in range(PICTURES)
            ]
        ),
        "conditions": lambda: [
            ask(f"/sessions/{name}/where?condition=speed_mph%20%3C%20{number}")
            for name in logs
            for number in (1, 2)
        ],
        "search": lambda: [ask(f"/sessions?where=speed_mph%20%3E%20{number}") for number in range(12)],
        "looking at pictures": look,
        "augmentations": lambda: [ask(f"/index.altered?others={number}") for number in range(4)],
        "rerun": rerun,
    }
    if runs:
        requests["runs"] = lambda: at_once([f"/runs/{run}" for run in runs] * 3)
        requests["predictions"] = predict
        requests["attention"] = lambda: at_once(
            [f"/sessions/{log}/attention/{run}/{row}" for row in range(0, 300, 3)]
        )
    return requests


def own_mb(process: psutil.Process) -> float:
    return float(process.memory_full_info().uss / 1e6)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("project", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as cache:
        line = [sys.executable, "-c", "from web.cli import main; main()", "--no-token", "--port", str(PORT)]
        with subprocess.Popen(line, cwd=asked.project, env={**os.environ, "BC_CACHE": cache}) as server:
            try:
                process = psutil.Process(server.pid)
                while not any(connection.laddr.port == PORT for connection in process.net_connections()):
                    time.sleep(0.1)
                print(f"started: {own_mb(process):.0f} MB")
                actions = uses()
                for turn in range(ROUNDS):
                    for name, use in actions.items():
                        use()
                        print(f"round {turn + 1}, after {name}: {own_mb(process):.0f} MB", flush=True)
            finally:
                server.terminate()


if __name__ == "__main__":
    main()
