"""How fast a log opens in the viewer, and how much memory it takes, by minutes of driving at 25 rows a second.

python benchmarks/playing.py sessions/lake.mcap drives/run.mcap [--minutes 10 120] [--folder .]

The rows of a session (three cameras) and of a drive (one camera, and the network's crops) are repeated until a log
is long enough. Three ways are measured: bc-play shows the log in a running headless viewer; bc-play writes an .rrd
file, which a headless viewer opens; the viewer opens the log itself, without curves, if it has at most ten
minutes. A log is completely shown when the view of the centre camera shows the last picture, which is green. A
jump begins at the first picture and ends when the last one is shown. Times include the start-up of bc-play; memory
is without mapped files. A headless viewer needs a graphics driver: on a bare server, Debian's package
mesa-vulkan-drivers.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from rerun.experimental import ViewerClient

from common.car import CAMERAS
from recorder import Log, LogWriter
from recorder.topics import PILOT_COMMAND, PILOT_INPUT, POSE, VEHICLE, camera_topic
from viz.playback.blueprint import DRIVEN_SPEED
from viz.targets import WINDOW_MEMORY
from viz.timelines import LOG_TIME
from viz.viewer_process import free_port, viewer_program

ROWS_A_SECOND: Final = 25
REPEATED: Final = 500  # rows
GREEN: Final = (0, 255, 0)
JUMPS: Final = 5
PATIENCE_S: Final = 300.0
MAX_BY_ITSELF_MINUTES: Final = 10.0  # of a longer log, the viewer itself needs minutes, and all memory
MIN_FREE_MB: Final = 1500  # with less memory, times are useless, and the system may kill other programs


@dataclass(frozen=True)
class Opened:
    """Measurements of opening a log: seconds until the viewer had the first curves and the first pictures, until
    all was sent, and until the last picture was shown; of a jump; megabytes of bc-play and of the viewer."""

    curves_s: float
    first_s: float
    sent_s: float
    seen_s: float
    jump_s: float
    player_mb: float
    viewer_mb: float


@dataclass(frozen=True)
class ByItself:
    """Measurements of a viewer that opens a log itself: seconds until the last picture was shown, and of a jump;
    megabytes."""

    seen_s: float
    jump_s: float
    viewer_mb: float


@dataclass(frozen=True)
class Saved:
    """Measurements of an .rrd file: seconds to write it, and until the last picture was shown; megabytes of the
    viewer."""

    written_s: float
    seen_s: float
    jump_s: float
    viewer_mb: float


WAYS: Final = {"play": Opened, "save": Saved, "itself": ByItself}


def write_long_log(source: Path, path: Path, minutes: float) -> None:
    """Write a log that repeats the rows of `source`. The last picture of the centre camera is green."""
    green = cv2.imencode(".jpg", np.full((160, 320, 3), GREEN, np.uint8))[1].tobytes()
    rows = int(minutes * 60 * ROWS_A_SECOND)
    with Log(source) as log, LogWriter(path, {"source": "benchmark"}) as writer:
        cameras = {camera: _contents(log, camera_topic(camera)) for camera in CAMERAS}
        crops, poses = _contents(log, PILOT_INPUT), [PoseInFrame.FromString(data) for data in _raw(log, POSE)]
        states = [state for _, state in log.vehicle_states()][:REPEATED] if log.counts.get(VEHICLE) else []
        commands = [command for _, command in log.commands()][:REPEATED] if log.counts.get(PILOT_COMMAND) else []
        start_ns, _ = log.time_range_ns
        for row in range(rows):
            time_ns = start_ns + row * 1_000_000_000 // ROWS_A_SECOND
            for camera, pictures in cameras.items():
                if pictures:
                    is_last = row == rows - 1 and camera == "center"
                    writer.picture(camera, time_ns, row, green if is_last else pictures[row % len(pictures)])
            if crops:
                writer.crop(time_ns, row, crops[row % len(crops)])
            if states:
                writer.vehicle(time_ns, row, states[row % len(states)])
            if commands:
                writer.command(time_ns, row, commands[row % len(commands)])
            if poses:
                writer.pose(time_ns, row, poses[row % len(poses)])


def _contents(log: Log, topic: str) -> list[bytes]:
    pictures = log.pictures(topic)
    places = zip(pictures.offset, pictures.length, pictures.chunk, strict=True)
    return [log.read(*map(int, place)) for place, _ in zip(places, range(REPEATED), strict=False)]


def _raw(log: Log, topic: str) -> list[bytes]:
    messages = log.messages(topic)[:REPEATED]
    return [log.read(message.offset, message.length, message.chunk) for message in messages]


def opened(log: Path) -> Opened:
    with viewer() as (process, client, port):
        start_s = time.perf_counter()
        player = subprocess.Popen(bc_play(str(log), "--connect", str(port)))
        curves_s = first_s = player_mb = viewer_mb = 0.0
        while player.poll() is None:
            player_mb, viewer_mb = max(player_mb, memory_mb(player.pid)), max(viewer_mb, memory_mb(process.pid))
            refuse_full_memory(player)
            if not curves_s:  # one question at a time: the viewer takes as long for an answer as for a frame
                if has_component(client, DRIVEN_SPEED, ":scalars"):
                    curves_s = time.perf_counter() - start_s
            elif not first_s and has_component(client, camera_topic("center"), ":blob"):
                first_s = time.perf_counter() - start_s
            time.sleep(0.05)
        sent_s = time.perf_counter() - start_s
        if player.returncode != 0:
            sys.exit(f"bc-play: exit code {player.returncode}")
        wait_for_last(client, log)
        seen_s = time.perf_counter() - start_s
        viewer_mb = max(viewer_mb, memory_mb(process.pid))
        return Opened(
            curves_s or sent_s, first_s or sent_s, sent_s, seen_s, jump(client, log), player_mb, viewer_mb
        )


def saved(log: Path, rrd: Path) -> Saved:
    start_s = time.perf_counter()
    subprocess.run(bc_play(str(log), "--save", str(rrd)), stdout=subprocess.DEVNULL, check=True)
    written_s = time.perf_counter() - start_s
    alone = by_itself(rrd, log)
    return Saved(written_s, alone.seen_s, alone.jump_s, alone.viewer_mb)


def by_itself(file: Path, log: Path) -> ByItself:
    """Let the viewer open `file`, which is the log or its .rrd file."""
    with viewer() as (process, client, _):
        start_s = time.perf_counter()
        with contextlib.suppress(TimeoutError):  # the viewer continues to open the file
            client.open(str(file.absolute()))
        viewer_mb = 0.0
        while is_loading(client):
            viewer_mb = max(viewer_mb, memory_mb(process.pid))
            refuse_full_memory(process)
            time.sleep(0.05)
        wait_for_last(client, log)
        seen_s = time.perf_counter() - start_s
        viewer_mb = max(viewer_mb, memory_mb(process.pid))
        return ByItself(seen_s, jump(client, log), viewer_mb)


def is_loading(client: ViewerClient) -> bool:
    try:
        return bool(client.get_state().loading)
    except TimeoutError:  # the viewer is busy
        return True


def jump(client: ViewerClient, log: Path) -> float:
    """Seconds from a jump to the log's end until the view of the centre camera shows the last picture, the median
    of `JUMPS`."""
    with Log(log) as read:
        first_ns, last_ns = read.time_range_ns
    jumps_s = []
    for _ in range(JUMPS):
        client.set_time(LOG_TIME, timestamp=np.datetime64(first_ns, "ns"), play_state="paused")
        while shows_green(client):
            time.sleep(0.01)
        start_s = time.perf_counter()
        client.set_time(LOG_TIME, timestamp=np.datetime64(last_ns, "ns"), play_state="paused")
        while not shows_green(client):
            time.sleep(0.01)
        jumps_s.append(time.perf_counter() - start_s)
    return statistics.median(jumps_s)


def wait_for_last(client: ViewerClient, log: Path) -> None:
    """Wait until the view of the centre camera shows the last picture."""
    with Log(log) as read:
        _, last_ns = read.time_range_ns
    deadline_s = time.perf_counter() + PATIENCE_S
    is_time_set = False
    while not is_time_set or not shows_green(client):
        if time.perf_counter() > deadline_s:
            sys.exit("the viewer does not show the last picture")
        with contextlib.suppress(TimeoutError):
            if not is_time_set:
                client.set_time(LOG_TIME, timestamp=np.datetime64(last_ns, "ns"), play_state="paused")
                is_time_set = True
        time.sleep(0.05)


def bc_play(*arguments: str) -> list[str]:
    return [sys.executable, "-c", "from viz.cli import main; main()", *arguments]


@contextlib.contextmanager
def viewer() -> Iterator[tuple[subprocess.Popen[bytes], ViewerClient, int]]:
    """Run a headless viewer with bc-play's other settings. Yields its process, a client and its port when it
    answers."""
    port = free_port()
    command = [str(viewer_program()), "--headless", "--bind", "127.0.0.1", "--port", str(port)]
    command += ["--server-memory-limit", WINDOW_MEMORY]
    with subprocess.Popen(
        [*command, "--hide-welcome-screen"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        try:
            yield process, answering(f"rerun+http://127.0.0.1:{port}/proxy"), port
        finally:
            process.terminate()


def answering(url: str) -> ViewerClient:
    for _ in range(100):
        with contextlib.suppress(Exception):  # its exceptions are not documented
            client = ViewerClient.connect(url)
            client.get_state()
            return client
        time.sleep(0.2)
    sys.exit("the viewer does not start")


def has_component(client: ViewerClient, entity: str, ending: str) -> bool:
    """True if an entity, or one below it, has a component whose name ends with `ending`."""
    try:
        schema = client.get_recording_schema(entity_path=entity)
    except Exception:  # no recording is open yet; its exceptions are not documented
        return False
    components = (component for entity in schema.entities for component in entity.components)
    return any(component.component.endswith(ending) for component in components)


def shows_green(client: ViewerClient) -> bool:
    try:
        view = next((view for view in client.get_state().views if view.origin == camera_topic("center")), None)
        if view is None:
            return False
        encoded = np.frombuffer(client.take_screenshot(view.view_id, max_size=200), np.uint8)
    except TimeoutError:
        return False
    shown = cv2.imdecode(encoded, cv2.IMREAD_COLOR)
    if shown is None:
        return False
    blue, green, red = np.moveaxis(shown, 2, 0)
    return bool(((green > 200) & (blue < 80) & (red < 80)).mean() > 0.2)


def memory_mb(pid: int) -> float:
    """Memory of a process in MB, without mapped files; 0 if it has ended."""
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines():
            if line.startswith("RssAnon"):
                return int(line.split()[1]) / 1024
    return 0.0


def refuse_full_memory(filling: subprocess.Popen[bytes]) -> None:
    lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    free_mb = next(int(line.split()[1]) / 1024 for line in lines if line.startswith("MemAvailable"))
    if free_mb < MIN_FREE_MB:
        filling.kill()
        sys.exit(f"only {free_mb:.0f} MB of memory are left")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("session", type=Path)
    parser.add_argument("drive", type=Path)
    parser.add_argument("--minutes", type=float, nargs="+", default=[10.0, 120.0])
    parser.add_argument("--folder", type=Path, default=Path())
    chosen = parser.parse_args()
    headings = ["log", "size"]
    headings += [f"{way}: {field.name.replace('_', ' ')}" for way, kind in WAYS.items() for field in fields(kind)]
    print(f"| {' | '.join(headings)} |\n|{'---|' * len(headings)}")
    for minutes in chosen.minutes:
        for kind, source in (("session", chosen.session), ("drive", chosen.drive)):
            with tempfile.TemporaryDirectory(dir=chosen.folder) as folder:
                log = Path(folder) / "long.mcap"
                write_long_log(source, log, minutes)
                os.sync()  # else the disk is still busy with it
                cells = [f"{kind}, {minutes:g} minutes", f"{log.stat().st_size / 1e6:,.0f} MB"]
                measurements: list[Opened | Saved | ByItself] = [opened(log), saved(log, log.with_suffix(".rrd"))]
                if minutes <= MAX_BY_ITSELF_MINUTES:
                    measurements.append(by_itself(log, log))
                for measured in measurements:
                    cells += [as_cell(name, value) for name, value in asdict(measured).items()]
                cells += ["not measured"] * (len(headings) - len(cells))
            print(f"| {' | '.join(cells)} |", flush=True)


def as_cell(name: str, value: float) -> str:
    return f"{value:,.0f} MB" if name.endswith("_mb") else f"{value:.2f} s"


if __name__ == "__main__":
    main()
