"""Reading logs from a bucket, compared with reading them from the disk.

python benchmarks/from_bucket.py SESSIONS logs         # bc-log info and bc-index: requests, bytes
python benchmarks/from_bucket.py SESSIONS long         # bc-log info of a log that a hole makes 8.4 GB long
python benchmarks/from_bucket.py SESSIONS training     # epochs of bc-train

SESSIONS is a folder of logs. A separate process serves them with localbucket, each request 50 ms late and all
answers together at 100 MB/s. The bucket's cache is empty before each first epoch.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator, Sequence
from dataclasses import replace
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final

import localbucket

from common.location import Location, Url
from common.object_store import find_object
from common.store_connection import forget_stores
from dataset import IndexConfig, build_index
from model.config import TrainConfig
from model.runs.training_progress import Epoch, Step
from model.training.trainer import train
from recorder import Log
from recorder.upkeep.log_info import describe

BUCKET: Final = "logs"
DELAY_S: Final = 0.05
BYTES_S: Final = 100e6
REPEATS: Final = 3
EPOCHS: Final = 3
GET_USD: Final = 0.0004 / 1000  # S3 Standard, us-east-1: a GET; bytes to the same region are free
INTERNET_USD_GB: Final = 0.09  # ... and to anywhere else


class _Late(localbucket.S3Handler):  # type: ignore[misc]
    """Answers after a delay, and limits the rate of all answers together to that of a network."""

    lock = threading.Lock()
    free_at = 0.0
    requests = 0
    sent = 0

    def log_message(self, *arguments: object) -> None: ...

    def do_GET(self) -> None:  # noqa: N802
        if self.path == "/counts":
            body = json.dumps([_Late.requests, _Late.sent]).encode()
            self.send_response(200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)
            return
        self._count_and_wait()
        super().do_GET()

    def do_HEAD(self) -> None:  # noqa: N802
        self._count_and_wait()
        super().do_HEAD()

    def do_PUT(self) -> None:  # noqa: N802
        self._count_and_wait()
        super().do_PUT()

    def _count_and_wait(self) -> None:
        with _Late.lock:
            _Late.requests += 1
        time.sleep(DELAY_S)

    def _send_file(self, status: Any, file: Any, start: int, length: int, headers: Any, include_body: Any) -> None:
        with _Late.lock:
            _Late.sent += length if include_body else 0
            begin = max(_Late.free_at, time.monotonic())
            _Late.free_at = begin + length / BYTES_S
            until = _Late.free_at
        time.sleep(max(0.0, until - time.monotonic()))
        super()._send_file(status, file, start, length, headers, include_body)


def serve(folder: Path) -> None:
    with ThreadingHTTPServer(("127.0.0.1", 0), type("Late", (_Late,), {"data_root": folder})) as server:
        print(server.server_port, flush=True)
        server.serve_forever()


class Server:
    """A server in a separate process."""

    def __init__(self, port: int, folder: Path) -> None:
        self.address = f"127.0.0.1:{port}"
        self.folder = folder  # of the bucket

    def counts(self) -> tuple[int, int]:
        """The numbers of requests and of sent bytes until now."""
        with urllib.request.urlopen(f"http://{self.address}/counts") as answer:
            requests, sent = json.load(answer)
        return requests, sent


@contextlib.contextmanager
def serving(sessions: Path) -> Iterator[Server]:
    """Serve copies of the logs in a bucket at s3:// during the block."""
    with tempfile.TemporaryDirectory(prefix="bc-bucket-") as folder:
        (Path(folder) / BUCKET).mkdir()
        for log in sorted(sessions.glob("*.mcap")):
            shutil.copy(log, Path(folder) / BUCKET / log.name)
        line = [sys.executable, __file__, folder, "serve"]
        with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None  # noqa: S101
            server = Server(int(process.stdout.readline()), Path(folder) / BUCKET)
            keys = {
                "AWS_ACCESS_KEY_ID": "benchmark",
                "AWS_SECRET_ACCESS_KEY": "benchmark",
                "AWS_REGION": "us-east-1",
            }
            os.environ.update(keys, AWS_ENDPOINT_URL_S3=f"http://{server.address}")
            forget_stores()
            try:
                yield server
            finally:
                process.terminate()


def print_logs(sessions: Path, server: Server) -> None:
    print("| | MB | requests | MB moved |\n|---|---|---|---|")
    for log in sorted(sessions.glob("*.mcap")):
        before = server.counts()
        describe(Url("s3", BUCKET, log.name))
        _print_moved(f"`bc-log info` {log.stem}", log.stat().st_size, server, before)
    total = sum(log.stat().st_size for log in sessions.glob("*.mcap"))
    with tempfile.TemporaryDirectory() as folder:
        for what in ("`bc-index`", "again"):
            before = server.counts()
            logs = [Url("s3", BUCKET, log.name) for log in sorted(sessions.glob("*.mcap"))]
            build_index(logs, Path(folder) / "index")
            _print_moved(what, total, server, before)
        read = _bytes_read()
        build_index(sorted(sessions.glob("*.mcap")), Path(folder) / "of_disk")
        print(
            f"| the same logs on a disk | {total / 1e6:,.1f} | | {(_bytes_read() - read) / 1e6:,.2f} |", flush=True
        )


def _bytes_read() -> int:
    """The bytes that this process has read from all files until now (Linux)."""
    return int(Path("/proc/self/io").read_text().split()[1])


def print_long(sessions: Path, server: Server) -> None:
    """Print the requests for a log with 32,000 more, empty chunks."""
    sys.path.append(str(Path(__file__).parents[1]))
    from tests.helpers.long_log import lengthened

    short = min(sessions.glob("*.mcap"), key=lambda log: log.stat().st_size)
    url = Url("s3", BUCKET, "long.mcap")
    path = lengthened(short, server.folder / url.name, 32_000)
    find_object(url)  # first: the server reads the whole log, for its ETag
    print("| | MB | requests | MB moved |\n|---|---|---|---|")
    before = server.counts()
    describe(url)
    _print_moved("`bc-log info`", path.stat().st_size, server, before)
    before = server.counts()
    with Log(url) as log:
        log.fingerprint  # noqa: B018
    _print_moved("its fingerprint", path.stat().st_size, server, before)
    for place in (path, url):
        seconds = []
        for _ in range(5):
            begin = time.process_time()
            describe(place)
            seconds.append(time.process_time() - begin)
        print(f"{place}: {1000 * min(seconds):.0f} ms of processor time")


def _print_moved(what: str, size: int, server: Server, before: tuple[int, int]) -> None:
    requests, sent = (now - then for now, then in zip(server.counts(), before, strict=True))
    print(f"| {what} | {size / 1e6:,.1f} | {requests:,} | {sent / 1e6:,.2f} |", flush=True)


def print_epochs(sessions: Path, server: Server, network: str) -> None:
    """Print the fastest epochs from the disk and from the bucket, measured in turn, because other programs only
    slow them. The second and later epochs have a warm cache."""
    names = [log.name for log in sorted(sessions.glob("*.mcap"))]
    places: dict[str, Sequence[Location]] = {
        "disk": [sessions / name for name in names],
        "bucket": [Url("s3", BUCKET, name) for name in names],
    }
    seconds: dict[str, list[list[float]]] = {"disk": [], "bucket": []}
    with tempfile.TemporaryDirectory(prefix="bc-bucket-") as folder:
        for where, logs in places.items():
            build_index(logs, Path(folder) / where, IndexConfig(labels="as-recorded"))
        for repeat in range(REPEATS):
            os.environ["BC_CACHE"] = f"{folder}/cache{repeat}"
            for where in ("disk", "bucket") if repeat % 2 == 0 else ("bucket", "disk"):
                before = server.counts()
                index = Path(folder) / where
                run = Path(folder) / "runs" / f"{where}{repeat}"
                seconds[where].append(_trained(index, run, network))
                if where == "bucket":
                    requests, sent = (now - then for now, then in zip(server.counts(), before, strict=True))
            shutil.rmtree(os.environ["BC_CACHE"])
    size = sum((sessions / name).stat().st_size for name in names)
    print(f"{size / 1e6:,.0f} MB of logs; all epochs together move {sent / 1e6:,.0f} MB in {requests:,} requests:")
    print(f"{requests * GET_USD:.5f} USD, and {sent / 1e9 * INTERNET_USD_GB:.3f} USD out of its region\n")
    print("| epoch | disk, s | bucket, s | speed of the disk's |\n|---|---|---|---|")
    for epoch in range(EPOCHS):
        disk, bucket = (min(epochs_s[epoch] for epochs_s in seconds[where]) for where in ("disk", "bucket"))
        print(f"| {epoch + 1} | {disk:.2f} | {bucket:.2f} | {disk / bucket:.3f} |")


class _Clock:
    """Stores the time at which each epoch of a training ends."""

    def __init__(self) -> None:
        self.at = [time.perf_counter()]

    def step(self, step: Step) -> None: ...

    def epoch(self, epoch: Epoch) -> None:
        self.at.append(time.perf_counter())

    def close(self) -> None: ...


def _trained(index: Path, run: Path, network: str) -> list[float]:
    """Seconds of each epoch. The first one begins with opening the logs."""
    settings = replace(TrainConfig(), epochs=EPOCHS, network=network, threads=1)
    clock = _Clock()
    train(index, run, settings, [clock], show_progress=False)
    return [after - before for before, after in itertools.pairwise(clock.at)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sessions", type=Path)
    parser.add_argument("what", choices=["logs", "long", "training", "serve"])
    parser.add_argument("--network", default=TrainConfig().network)
    arguments = parser.parse_args()
    if arguments.what == "serve":
        serve(arguments.sessions)
        return
    with serving(arguments.sessions) as server:
        match arguments.what:
            case "logs":
                print_logs(arguments.sessions, server)
            case "long":
                print_long(arguments.sessions, server)
            case _:
                print_epochs(arguments.sessions, server, arguments.network)


if __name__ == "__main__":
    main()
