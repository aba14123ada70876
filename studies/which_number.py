"""Which number predicts how a network drives? Many networks, all offline measures of each, and their drives.

python studies/which_number.py FOLDER [--jobs 2] [--seeds 0 1 2] [--recipes original ...] [--report]

The study records half laps of both tracks by the expert and by the simulated keyboard driver, and other drives
that are held out. It trains each recipe with each seed, and takes the network after one and four epochs, and after
ten with the default recipe. Each network predicts the recordings held out, and drives (`bc-eval drive`).

Existing results in FOLDER are not computed again: stop the study (Ctrl-C) and start it again at any time. Every
job has one thread, and --jobs of them run at once. At the end, or at any time with --report,
which_number_report.py makes the parquet, the table and the figure of the existing results.
"""

from __future__ import annotations

import argparse
import itertools
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import which_number_report as report
from toolkit_command import command_line, environment

from common.files import atomic_file

KNOWN: Final = ("lake", "mountain")
HELD_OUT_ROADS: Final = ("random:101", "random:102", "random:103")  # recorded, and predicted
DRIVEN: Final = (*KNOWN, "random:1", "random:2", "random:3", "random:4", "random:5")
PREDICT: Final = Path(__file__).resolve().with_name("which_number_predict.py")
LEARNT_SEED, HELD_OUT_SEED = 1, 2
RECORDED_LAPS: Final = {LEARNT_SEED: 0.5, HELD_OUT_SEED: 0.25}

SMALL: Final = ("--per-bin", "150")  # 3,750 samples an epoch: half a minute for four
ORIGINAL: Final = ("--recipe", "original")
PEOPLE: Final = ("--recipe", "people")
ALTERED: Final = ("--recipe", "altered")
TO_THE_END: Final = (1, 4, 10)  # ten are the recipes' default


@dataclass(frozen=True)
class Recipe:
    """How to train a kind of networks."""

    index: tuple[str, ...]
    train: tuple[str, ...]
    driver: str = "keyboard"
    epochs: tuple[int, ...] = (1, 4)  # after which networks are taken


RECIPES: Final = {
    "original": Recipe((*ORIGINAL, *SMALL), ORIGINAL),
    "original + labels": Recipe((*PEOPLE, *SMALL), ORIGINAL),
    "original + answers": Recipe((*ORIGINAL, *SMALL), (*ORIGINAL, "--answers", "natural")),
    "original + averaged": Recipe((*ORIGINAL, *SMALL), (*ORIGINAL, "--average-steps", "100")),
    "people": Recipe((*PEOPLE, *SMALL), PEOPLE),
    "people, as learnt": Recipe((*PEOPLE, *SMALL), (*PEOPLE, "--answers", "as-learnt")),
    "people, not balanced": Recipe((*PEOPLE, "--no-balance", "--where", "row % 3 = 0"), PEOPLE),
    "people, half balanced": Recipe(
        (*PEOPLE, "--per-bin", "500", "--max-uses", "1", "--where", "row % 2 = 0"), PEOPLE
    ),
    "people, side 0.1": Recipe((*PEOPLE, *SMALL, "--side-correction", "0.1"), PEOPLE),
    "people, centre camera": Recipe((*PEOPLE, *SMALL, "--cameras", "center"), PEOPLE),
    "people, a quarter": Recipe((*PEOPLE, *SMALL, "--where", "row < 280"), PEOPLE),
    "people, a tenth": Recipe((*PEOPLE, "--per-bin", "60", "--where", "row < 110"), PEOPLE),
    "expert, original": Recipe((*ORIGINAL, *SMALL), ORIGINAL, driver="expert"),
    "expert, people": Recipe((*PEOPLE, *SMALL), PEOPLE, driver="expert"),
    "altered": Recipe((), ALTERED, epochs=TO_THE_END),
    "altered, a quarter": Recipe((*SMALL, "--where", "row < 280"), ALTERED, epochs=TO_THE_END),
    "altered, a tenth": Recipe(("--per-bin", "60", "--where", "row < 110"), ALTERED, epochs=TO_THE_END),
    "expert, altered": Recipe(SMALL, ALTERED, driver="expert", epochs=TO_THE_END),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--jobs", type=int, default=2, help="number of jobs at once, with one thread each")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--recipes", nargs="+", choices=RECIPES, default=list(RECIPES))
    parser.add_argument("--report", action="store_true", help="only report the existing results")
    arguments = parser.parse_args()
    folder = arguments.folder.resolve()
    if not arguments.report:
        study = Study(folder)
        trainings = list(itertools.product(arguments.seeds, arguments.recipes))  # so that all recipes come early
        with Jobs(arguments.jobs) as jobs:
            study.jobs = jobs
            jobs.map(lambda drive: study.record(*drive), [*study.learnt_drives(), *study.held_out_drives()])
            jobs.map(study.index, arguments.recipes)
            trained = jobs.map(lambda training: study.train(*training), trainings)
            networks = [network for training in trained for network in reversed(training)]
            steps = (study.predict, study.drive)
            jobs.map(lambda step: step[1](step[0]), list(itertools.product(networks, steps)))
    report.write(folder)


class Jobs:
    """Runs commands, some at once. An error in one, or a signal, ends all."""

    def __init__(self, count: int) -> None:
        self._pool = ThreadPoolExecutor(count)
        self._running: set[subprocess.Popen[str]] = set()
        self._lock = threading.Lock()
        self._is_over = False

    def __enter__(self) -> Jobs:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        return self

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._is_over = True
            for process in self._running:
                process.terminate()  # they leave no partial result; the next start repeats them
        self._pool.shutdown(cancel_futures=True)

    def map(self, work: Callable[[Any], Any], items: Iterable[Any]) -> list[Any]:
        """Run a job for each item. Returns the results in order."""
        futures = [self._pool.submit(work, item) for item in items]
        done, _ = wait(futures, return_when=FIRST_EXCEPTION)
        for future in done:
            future.result()
        return [future.result() for future in futures]

    def bc(self, folder: Path, name: str, *arguments: object) -> str:
        """Run a `bc-` command in the folder. Returns its output."""
        return self.run(folder, " ".join(map(str, (name, *arguments))), command_line(name, *arguments))

    def run(self, folder: Path, shown: str, line: Sequence[str | Path]) -> str:
        """Run a program, printed as `shown`, in the folder with one thread. Returns its output."""
        begin_s = time.monotonic()
        with self._lock:
            if self._is_over:
                raise SystemExit(1)
            process = subprocess.Popen(
                line,
                cwd=folder,
                env={**environment(), "OMP_NUM_THREADS": "1"},
                text=True,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C reaches only this process
            )
            self._running.add(process)
        output, errors = process.communicate()
        with self._lock:
            self._running.discard(process)
        if process.returncode not in (0, 3):
            raise SystemExit(f"{shown}: exit code {process.returncode}\n{errors}")
        print(f"{time.monotonic() - begin_s:6.1f} s  {shown}", file=sys.stderr, flush=True)
        return str(output)


class Study:
    """The steps of the study. Each leaves a file or folder that shows that it is done."""

    jobs: Jobs

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in ("sessions", "indexes", "runs", "networks", "drives"):
            (folder / name).mkdir(parents=True, exist_ok=True)

    def learnt_drives(self) -> list[tuple[str, str, int]]:
        return [(track, driver, LEARNT_SEED) for driver in ("keyboard", "expert") for track in KNOWN]

    def held_out_drives(self) -> list[tuple[str, str, int]]:
        roads = (*KNOWN, *HELD_OUT_ROADS)
        return [(track, driver, HELD_OUT_SEED) for driver in ("keyboard", "expert") for track in roads]

    def record(self, track: str, driver: str, seed: int) -> None:
        name = session(track, driver, seed)
        log = self.folder / "sessions" / f"{name}.mcap"
        if not log.exists():  # recorded to unfinished/ first, because a stopped recording is a valid, shorter log
            flags = ("--track", track, "--driver", driver, "--laps", RECORDED_LAPS[seed], "--seed", seed)
            # the keyboard driver of a held-out recording is not pushed off the line from time to time
            recovery = ("--recovery", 0) if seed == HELD_OUT_SEED and driver == "keyboard" else ()
            self.jobs.bc(self.folder, "bc-record", name, *flags, *recovery, "--sessions", "unfinished", "--force")
            (self.folder / "unfinished" / log.name).rename(log)

    def index(self, name: str) -> None:
        recipe = RECIPES[name]
        index = self.folder / "indexes" / file_name(name)
        if not (index / "samples.parquet").exists():
            sessions = [session(track, recipe.driver, LEARNT_SEED) for track in KNOWN]
            self.jobs.bc(self.folder, "bc-index", *sessions, "--index", index, *recipe.index)

    def train(self, seed: int, name: str) -> list[str]:
        """Train, and copy the network after each of the epochs. Returns the names of the networks."""
        training = f"{file_name(name)}-s{seed}"
        for epochs in RECIPES[name].epochs:
            taken = self.folder / "networks" / f"{training}-e{epochs}"
            if not taken.exists():
                self._train(name, seed, training, epochs)
                self._take(training, taken)
        return [f"{training}-e{epochs}" for epochs in RECIPES[name].epochs]

    def _train(self, name: str, seed: int, training: str, epochs: int) -> None:
        run = self.folder / "runs" / training
        how = ("--epochs", epochs, "--threads", 1, "--device", "cpu")
        if run.exists():
            self.jobs.bc(self.folder, "bc-train", "resume", training, *how)
        else:
            index = ("--index", self.folder / "indexes" / file_name(name))
            flags = (*RECIPES[name].train, "--keep", "last", "--seed", seed)
            self.jobs.bc(self.folder, "bc-train", "--name", training, *index, *flags, *how)

    def _take(self, training: str, taken: Path) -> None:
        """Copy a run without its checkpoint."""
        part = taken.with_name(f"{taken.name}.part")
        shutil.rmtree(part, ignore_errors=True)
        shutil.copytree(self.folder / "runs" / training, part, ignore=shutil.ignore_patterns("last"))
        part.rename(taken)

    def predict(self, network: str) -> None:
        """Store the network's prediction for every held-out frame, from which the report computes all measures."""
        kept = self.folder / "predictions" / f"{network}.parquet"
        if kept.exists():
            return
        logs = [self.folder / "sessions" / f"{session(*drive)}.mcap" for drive in self.held_out_drives()]
        line: list[str | Path] = [sys.executable, PREDICT, self.folder / "networks" / network, kept, *logs]
        self.jobs.run(self.folder, f"predict {network}", line)

    def drive(self, network: str) -> None:
        """Drive the simulator. The logs, 100 MB each, are deleted."""
        kept = self.folder / "driven" / f"{network}.jsonl"
        if kept.exists():
            return
        with tempfile.TemporaryDirectory(dir=self.folder / "drives") as logs:
            flags = ("--tracks", *DRIVEN, "--laps", 0.25, "--speed", 15)
            output = self.jobs.bc(
                self.folder, "bc-eval", "drive", network, "--runs", "networks", *flags, "--drives", logs, "--json"
            )
        with atomic_file(kept, overwrite=True) as part:
            part.write_text(output)


def session(track: str, driver: str, seed: int) -> str:
    return f"{track.replace(':', '-')}-{driver}-{seed}"


def file_name(recipe: str) -> str:
    return recipe.replace(" + ", "+").replace(", ", "-").replace(" ", "_")


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("stopped; the same command continues")
