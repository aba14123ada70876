"""This version beside an earlier one: importing, writing, indexing, opening and loading, with logs of its own.

git worktree add ../before COMMIT
python benchmarks/versions.py lake_windows --before ../before [--gigabytes 2] [--hours 2] [--folder .]

lake_windows is a folder of Udacity's simulator. Both versions run in this Python, whose packages they share; each
task (version_tasks.py) in a process of its own, in turns. Given are medians of the rounds (least to most), and how
often this version does in the time of the earlier one what that does once: the median over the rounds of the ratio
within each. "Cold": the page cache holds nothing of the log; bytes are those that the system counts, as shares of
the log's. A viewer without a window needs a graphics driver: on a bare server, Debian's package
mesa-vulkan-drivers.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from subprocess import DEVNULL
from typing import Final

from playing import bc_play, has_component, viewer

from recorder.log.topics import STEERING, camera_topic

HERE: Final = Path(__file__).absolute().parent
POLL_S: Final = 0.02
LIVE_S: Final = 10.0
LIVE_ROWS: Final = 5000
WRITTEN_GB: Final = 0.5
PARTS: Final = ("writing", "indexing", "opening", "loading")
LONG_GB_AN_HOUR: Final = 4.2  # 25 rows a second of that recording's pictures

Result = dict[str, float]


@dataclass(frozen=True)
class Version:
    """A checkout, and what its commands run in."""

    name: str
    checkout: Path

    @property
    def environment(self) -> dict[str, str]:
        return {**os.environ, "PYTHONPATH": str(self.checkout), "OMP_NUM_THREADS": "1"}

    def task(self, *arguments: object) -> Result:
        """A task of version_tasks.py: what it prints."""
        line = [sys.executable, str(HERE / "version_tasks.py"), *map(str, arguments)]
        done = subprocess.run(line, env=self.environment, stdout=subprocess.PIPE, text=True, check=True)
        result: Result = json.loads(done.stdout)
        return result

    def opened(self, log: Path) -> Result:
        """Seconds from the start of `bc-play` until a viewer has the curves, and until it has pictures."""
        with viewer() as (_, client, port):
            start_s = time.perf_counter()
            line = bc_play(str(log), "--connect", str(port))
            with subprocess.Popen(line, env=self.environment, stdout=DEVNULL, stderr=DEVNULL) as player:
                found = {"curves_s": (STEERING.path, ":scalars"), "pictures_s": (camera_topic("center"), ":blob")}
                result: Result = {}
                while len(result) < len(found) and player.poll() is None:
                    for name, (entity, component) in found.items():
                        if name not in result and has_component(client, entity, component):
                            result[name] = time.perf_counter() - start_s
                    time.sleep(POLL_S)
                player.kill()
        if len(result) < len(found):
            sys.exit(f"bc-play {log}: ended before everything was there ({self.name})")
        return result


Measured = dict[str, list[Result]]
"""The rounds of each version, by its name."""


def in_turns(versions: list[Version], rounds: int, measure: Callable[[Version], Result]) -> Measured:
    found: Measured = {version.name: [] for version in versions}
    for _ in range(rounds):
        for version in versions:
            found[version.name].append(measure(version))
    return found


def forget(log: Path) -> None:
    """Drop a file from the page cache."""
    with log.open("rb") as stream:
        os.fsync(stream.fileno())
        os.posix_fadvise(stream.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def told(what: str, found: Measured, value: Callable[[Result], float], form: str, *, more_is_better: bool) -> None:
    """A line of the table."""
    before, now = ([value(result) for result in results] for results in found.values())
    cells = [
        f"{statistics.median(values):{form}} ({min(values):{form}} to {max(values):{form}})"
        for values in (before, now)
    ]
    ratios = [(b / a if more_is_better else a / b) if a and b else 1.0 for a, b in zip(before, now, strict=True)]
    print(f"| {what} | {' | '.join(cells)} | {statistics.median(ratios):.2f} |", flush=True)


def per_s(name: str) -> Callable[[Result], float]:
    return lambda result: result[name] / result["seconds"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--before", type=Path, required=True, help="a checkout of the earlier version")
    parser.add_argument("--gigabytes", type=float, default=2.0, help="of the log that is indexed")
    parser.add_argument("--hours", type=float, default=2.0, help="of the log that is opened")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--folder", type=Path, default=Path(), help="where there is room for logs")
    chosen = parser.parse_args()
    versions = [Version("before", chosen.before.absolute()), Version("now", HERE.parent)]
    print(f"| {chosen.rounds} rounds | before | now | ratio |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory(dir=chosen.folder) as name:
        folder = Path(name)
        if "writing" in chosen.only:
            writing(versions, chosen.recording, folder, chosen.rounds)
        if "indexing" in chosen.only:
            indexing(versions, chosen.recording, folder, chosen.gigabytes, chosen.rounds)
        if "opening" in chosen.only:
            opening(versions, chosen.recording, folder, chosen.hours * LONG_GB_AN_HOUR, chosen.rounds)
        if "loading" in chosen.only:
            loading(versions, chosen.recording, folder, chosen.rounds)


def writing(versions: list[Version], recording: Path, folder: Path, rounds: int) -> None:
    found = in_turns(versions, rounds, lambda version: version.task("import_recording", recording))
    told("import, pictures/s", found, per_s("pictures"), ",.0f", more_is_better=True)
    told("... by processor seconds", found, lambda it: it["pictures"] / it["cpu_s"], ",.0f", more_is_better=True)

    def write(version: Version) -> Result:
        log = folder / "written.mcap"
        result = version.task("long_log", recording, log, WRITTEN_GB)
        log.unlink()
        return result

    found = in_turns(versions, rounds, write)
    told("writing a session, rows/s", found, per_s("rows"), ",.0f", more_is_better=True)
    told("... by processor seconds", found, lambda it: it["rows"] / it["cpu_s"], ",.0f", more_is_better=True)
    found = in_turns(versions, rounds, lambda version: version.task("live", recording, LIVE_S))
    for name, what in (("p50_ms", "p50"), ("p99_ms", "p99"), ("most_ms", "most")):
        told(f"a live row, 60 a second, {what} in ms", found, _of(name), ".2f", more_is_better=False)
    found = in_turns(versions, rounds, lambda version: version.task("live_at_once", recording, LIVE_ROWS))
    told("live rows at once, rows/s", found, _of("rows_per_s"), ",.0f", more_is_better=True)
    told("... by processor seconds", found, lambda it: LIVE_ROWS / it["cpu_s"], ",.0f", more_is_better=True)


def indexing(versions: list[Version], recording: Path, folder: Path, gigabytes: float, rounds: int) -> None:
    logs = long_logs(versions, recording, folder, gigabytes)

    def index(version: Version, *, is_cold: bool) -> Result:
        if is_cold:
            forget(logs[version.name])
        return version.task("frames", logs[version.name])

    share = 100 / (gigabytes * 1e9)
    found = in_turns(versions, 1 + rounds, lambda version: index(version, is_cold=False))
    found = {name: results[1:] for name, results in found.items()}  # the first fills the page cache
    told(f"indexing {gigabytes:g} GB, frames/s", found, per_s("frames"), ",.0f", more_is_better=True)
    told("... by processor seconds", found, lambda it: it["frames"] / it["cpu_s"], ",.0f", more_is_better=True)
    told("... bytes asked for, %", found, lambda it: share * it["asked_bytes"], ".2f", more_is_better=False)
    found = in_turns(versions, rounds, lambda version: index(version, is_cold=True))
    told("... cold, frames/s", found, per_s("frames"), ",.0f", more_is_better=True)
    told(
        "... cold, bytes from the disk, %", found, lambda it: share * it["disk_bytes"], ".2f", more_is_better=False
    )

    def whole(version: Version) -> Result:
        with tempfile.TemporaryDirectory(dir=folder) as index:
            return version.task("command", index, "bc-index", logs[version.name].absolute())

    found = in_turns(versions, rounds, whole)
    told("`bc-index`, all of it, s", found, _of("seconds"), ".2f", more_is_better=False)
    for log in logs.values():
        log.unlink()


def opening(versions: list[Version], recording: Path, folder: Path, gigabytes: float, rounds: int) -> None:
    logs = long_logs(versions, recording, folder, gigabytes)
    for is_cold in (False, True):
        how = ", cold" if is_cold else ""

        def info(version: Version, is_cold: bool = is_cold) -> Result:
            if is_cold:
                forget(logs[version.name])
            return version.task("command", folder, "bc-log", "info", logs[version.name].absolute())

        found = in_turns(versions, rounds, info)
        told(f"`bc-log info` of {gigabytes:.1f} GB{how}, s", found, _of("seconds"), ".2f", more_is_better=False)
        told("... most memory, MB", found, _of("command_mb"), ",.0f", more_is_better=False)
        if is_cold:
            read = _of("command_disk_bytes", 1e-6)
            told("... bytes from the disk, MB", found, read, ",.1f", more_is_better=False)
    for is_cold in (False, True):
        how = ", cold" if is_cold else ""

        def opened(version: Version, is_cold: bool = is_cold) -> Result:
            if is_cold:
                forget(logs[version.name])
            return version.opened(logs[version.name])

        found = in_turns(versions, rounds, opened)
        told(f"`bc-play`, first curves{how}, s", found, _of("curves_s"), ".2f", more_is_better=False)
        told(f"... first pictures{how}, s", found, _of("pictures_s"), ".2f", more_is_better=False)
    for log in logs.values():
        log.unlink()


def loading(versions: list[Version], recording: Path, folder: Path, rounds: int) -> None:
    for version in versions:
        its = folder / version.name
        its.mkdir()
        version.task("command", its, "bc-record", "lake", "--from", recording.absolute())
        version.task("command", its, "bc-index", "--no-balance", "--no-flip", "--gap-s", 0)
    found = in_turns(versions, rounds, lambda version: version.task("load", folder / version.name / "index", 1))
    for name, what in (("first_per_s", "a first epoch"), ("later_per_s", "later ones")):
        told(f"random pictures, {what}, pictures/s", found, _of(name), ",.0f", more_is_better=True)
    told("one random JPEG by its place, us", found, _of("read_us"), ".2f", more_is_better=False)


def long_logs(versions: list[Version], recording: Path, folder: Path, gigabytes: float) -> dict[str, Path]:
    """A log of each version's own making."""
    logs = {version.name: folder / f"{version.name}-{gigabytes:g}.mcap" for version in versions}
    for version in versions:
        version.task("long_log", recording, logs[version.name], gigabytes)
    return logs


def _of(name: str, factor: float = 1.0) -> Callable[[Result], float]:
    return lambda result: factor * result[name]


if __name__ == "__main__":
    main()
