"""The server's memory is bounded: what requests have freed goes back, and few large logs are kept open."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil  # type: ignore[import-untyped]  # comes with rerun-sdk
import pytest

import web.logs.open_logs
from tests.helpers.driving import Process, command, environment, road_jpeg
from tests.helpers.logs import write_log
from tests.helpers.ports import free_ports
from tests.helpers.workbench import Served, served_by
from web.logs.open_logs import OpenLogs
from web.server.workbench_server import EVERY

ROWS = 3000
THREADS = """
import sys, threading
import numpy as np, psutil
from web.server.workbench_server import give_memory_back, trim
if sys.argv[1] == "bounded": give_memory_back()
own = psutil.Process().memory_full_info
all_hold_it = threading.Barrier(12)
def use():
    for _ in range(2):
        held = [np.ones(20_000) for _ in range(100)], [bytearray(3000) for _ in range(1000)]
        all_hold_it.wait()
before = own().uss
threads = [threading.Thread(target=use) for _ in range(12)]
for thread in threads: thread.start()
for thread in threads: thread.join()
if sys.argv[1] == "bounded": trim()
print(own().uss - before)
"""


def kept_by_threads(how: str) -> int:
    """Bytes that a process still has after twelve threads have used 20 MB each, and ended."""
    line = [sys.executable, "-c", THREADS, how]
    return int(subprocess.run(line, env=environment(), capture_output=True, text=True, check=True).stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="other C libraries have no such setting")
def test_what_threads_have_freed_goes_back() -> None:
    assert kept_by_threads("bounded") < kept_by_threads("as it is") / 3


def test_few_large_logs_are_kept_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logs = [write_log(tmp_path / "sessions" / f"{name}.mcap", [0.1] * 20) for name in "abc"]
    opened = OpenLogs()
    with opened.open(logs[0]) as first:
        pass
    monkeypatch.setattr(web.logs.open_logs, "MAX_MESSAGES", 2 * first.messages)
    with opened.open(logs[1]), opened.open(logs[0]) as again:
        assert again is first  # two are not too many
    with opened.open(logs[2]), opened.open(logs[0]) as again:
        assert again is first  # the one that was used last
    monkeypatch.setattr(web.logs.open_logs, "MAX_MESSAGES", 1)
    with opened.open(logs[1]) as large:
        pass
    with opened.open(logs[1]) as again:
        assert again is large  # one is always kept
    with opened.open(logs[0]) as again:
        assert again is not first
    opened.close()


@pytest.mark.long
def test_memory_does_not_grow_with_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in "abcdef":
        write_log(tmp_path / "sessions" / f"{name}.mcap", [0.01 * (row % 90) for row in range(ROWS)], road)
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    with Process(command("bc-web", "--port", *free_ports(1)), cwd=tmp_path) as process:
        bench = served_by(process, tmp_path)
        own_mb = []
        for _ in range(4):
            use(bench)
            own_mb.append(psutil.Process(process.popen.pid).memory_full_info().uss / 1e6)
    assert own_mb[-1] < own_mb[0] + 15, own_mb


def road(camera: str, row: int) -> bytes:
    return road_jpeg(row % 50)


def use(bench: Served) -> None:
    paths = [f"/sessions/{name}{part}" for name in "abcdef" for part in ("", "/state", "/rows", "/strip.jpg") * 5]
    paths += [f"/sessions/{'abcdef'[at % 6]}/pictures/center/{at * 97 % ROWS}" for at in range(4 * EVERY)]
    with ThreadPoolExecutor(12) as pool:
        assert {answer.status for answer in pool.map(bench.get, paths)} == {200}
