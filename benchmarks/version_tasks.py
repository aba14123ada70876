"""The tasks of versions.py, each in a process of its own, in whichever version is on PYTHONPATH.

python benchmarks/version_tasks.py TASK ARGUMENTS...

Prints one line of JSON: what the task returns, and what the process took for it: seconds, processor seconds, the
bytes that it asked for and those that the system read from the disk for it, and the most memory until then. The
start of Python, and what the task imports, are not in it; of a command they are.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

ROW_NS: Final = 40_000_000  # 25 rows a second
START_NS: Final = 1_720_880_000_000_000_000
PICTURES: Final = 200  # rows of a recording, again and again
LIVE_ROWS_A_SECOND: Final = 60
BATCH: Final = 256

Result = dict[str, Any]
Task = Callable[[], Result]


def long_log(recording: str, path: str, gigabytes: str) -> Task:
    """Writes a session: all three cameras, and what the car did."""
    from common.car import CAMERAS
    from recorder import LogWriter
    from recorder.bc_pb2 import VehicleState

    pictures = [[image.read_bytes() for image in images] for images in _pictures(Path(recording))]

    def write() -> Result:
        row = 0
        with LogWriter(Path(path), {"source": "benchmark"}) as writer:
            while writer.bytes_written < float(gigabytes) * 1e9:
                time_ns = START_NS + row * ROW_NS
                for camera, picture in zip(CAMERAS, pictures[row % len(pictures)], strict=True):
                    writer.picture(camera, time_ns, row, picture)
                state = VehicleState(steering=(row % 50 - 25) / 50, throttle=0.3, speed_mph=10.0)
                writer.vehicle(time_ns, row, state)
                row += 1
        return {"rows": row}

    return write


def frames(log: str) -> Task:
    """What indexing takes out of a log: where its pictures are, and the row of each."""
    from dataset import IndexConfig
    from dataset.frames.frames_table import frames_table
    from recorder import Log, LogWriter
    from recorder.bc_pb2 import VehicleState

    def index(path: Path) -> Result:
        with tempfile.TemporaryDirectory() as name, Log(path) as opened:
            return {"frames": len(frames_table(opened, Path(name), IndexConfig(), ()))}

    with tempfile.TemporaryDirectory() as name:  # what is imported only when it is needed
        path = Path(name) / "small.mcap"
        with LogWriter(path, {"source": "benchmark"}) as writer:
            for row in range(10):
                writer.picture("center", START_NS + row * ROW_NS, row, b"picture")
                writer.vehicle(START_NS + row * ROW_NS, row, VehicleState())
        index(path)
    return lambda: index(Path(log))


def import_recording(recording: str) -> Task:
    from recorder import import_udacity

    def import_it() -> Result:
        with tempfile.TemporaryDirectory() as name:
            return {"pictures": import_udacity(Path(recording), Path(name) / "log.mcap").pictures}

    return import_it


def live(recording: str, seconds: str) -> Task:
    """A drive's rows, 60 a second: how long each takes to be written, in ms."""
    return _live(recording, int(float(seconds) * LIVE_ROWS_A_SECOND), LIVE_ROWS_A_SECOND)


def live_at_once(recording: str, rows: str) -> Task:
    """A drive's rows as fast as they are taken."""
    return _live(recording, int(rows), None)


def _live(recording: str, rows: int, rows_a_second: int | None) -> Task:
    import cv2
    import numpy as np
    from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

    from dataset import decode, preprocess
    from recorder import LogWriter
    from recorder.bc_pb2 import PilotCommand, VehicleState

    pictures = [images[0].read_bytes() for images in _pictures(Path(recording))]
    crops = [cv2.imencode(".png", preprocess(decode(picture)))[1].tobytes() for picture in pictures]

    def write() -> Result:
        taken_ms = []
        with ExitStack() as stack:
            path = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "log.mcap"
            with LogWriter(path, {"source": "benchmark"}, live=True) as writer:
                begin_s = time.perf_counter()
                for row in range(rows):
                    if rows_a_second:
                        time.sleep(max(0.0, begin_s + row / rows_a_second - time.perf_counter()))
                    start_s = time.perf_counter()
                    time_ns = START_NS + row * ROW_NS
                    writer.picture("center", time_ns, row, pictures[row % len(pictures)])
                    writer.crop(time_ns, row, crops[row % len(crops)])
                    writer.vehicle(time_ns, row, VehicleState(steering=0.1, throttle=0.3, speed_mph=10.0))
                    writer.command(time_ns, row, PilotCommand(predicted_steering=0.1, total_ms=3.0))
                    writer.pose(time_ns, row, PoseInFrame(frame_id="world"))
                    taken_ms.append(1e3 * (time.perf_counter() - start_s))
                written_s = time.perf_counter() - begin_s
        p50, p99 = np.percentile(taken_ms, (50, 99))
        return {"rows_per_s": rows / written_s, "p50_ms": p50, "p99_ms": p99, "most_ms": max(taken_ms)}

    return write


def load(index: str, threads: str) -> Task:
    """Random pictures of an index: a first epoch, in which every chunk's CRC is computed, and one after it; and
    single pictures by their places."""
    import numpy as np
    import pyarrow.compute as pc

    from dataset import Loader, Samples

    def epoch(loader: Any, number: int) -> float:
        start_s = time.perf_counter()
        count = sum(len(batch.pictures) for batch in loader.epoch(number))
        return count / (time.perf_counter() - start_s)

    def read_all() -> Result:
        samples = Samples(Path(index))
        table = samples.table.filter(pc.invert(pc.or_(samples.table["flip"], samples.table["copy"])))
        with Loader(samples, table, batch=BATCH, budget_bytes=0, threads=int(threads)) as loader:
            first, later = epoch(loader, 0), epoch(loader, 1)
            rows = table.take(np.random.default_rng(0).permutation(len(table))).to_pylist()
            places = [(samples.logs[row["session"]], row["offset"], row["length"], row["chunk"]) for row in rows]
            start_s = time.perf_counter()
            for log, *place in places:
                log.read(*place)
            each_us = 1e6 * (time.perf_counter() - start_s) / len(places)
        return {"pictures": len(table), "first_per_s": first, "later_per_s": later, "read_us": each_us}

    return read_all


def command(folder: str, name: str, *arguments: str) -> Task:
    """A whole `bc-` command in a folder. This process is small: no child's most memory is under its parent's."""

    def run() -> Result:
        code = f"from behavioural_cloning_toolkit import {name.replace('-', '_')} as main; main()"
        line = [sys.executable, "-c", code, *arguments]
        done = subprocess.run(line, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, check=False)
        if done.returncode:
            sys.exit(f"{name} {' '.join(arguments)}: exit code {done.returncode}: {done.stderr.decode()}")
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return {"command_mb": used.ru_maxrss / 1024, "command_disk_bytes": used.ru_inblock * 512}

    return run


TASKS: Final[dict[str, Callable[..., Task]]] = {
    task.__name__: task for task in (long_log, frames, import_recording, live, live_at_once, load, command)
}


def _pictures(recording: Path) -> Iterator[list[Path]]:
    """The pictures of the first rows of a Udacity recording: centre, left, right."""
    found = sorted((recording / "IMG").glob("center_*.jpg"))[:PICTURES]
    for center in found:
        yield [
            center.with_name(center.name.replace("center", camera, 1)) for camera in ("center", "left", "right")
        ]


def _disk() -> dict[str, int]:
    """What this process has asked for, and what was read from the disk for it, in bytes."""
    lines = Path("/proc/self/io").read_text(encoding="ascii").splitlines()
    told = {name: int(value) for name, value in (line.split(": ") for line in lines)}
    return {"asked_bytes": told["rchar"], "disk_bytes": told["read_bytes"]}


def main() -> None:
    task = TASKS[sys.argv[1]](*sys.argv[2:])
    before, start_s, start_cpu_s = _disk(), time.perf_counter(), time.process_time()
    result = task()
    seconds, cpu_s, after = time.perf_counter() - start_s, time.process_time() - start_cpu_s, _disk()
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    read = {name: after[name] - before[name] for name in after}
    print(json.dumps({**result, "seconds": seconds, "cpu_s": cpu_s, **read, "memory_mb": memory_mb}))


if __name__ == "__main__":
    main()
