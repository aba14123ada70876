"""Which number tells how a network drives? Many networks, every offline measure of each, and how they drive.

python studies/which_number.py FOLDER [--jobs 2] [--seeds 0 1 2] [--epochs 1 4] [--recipes original ...]
    [--laps 0.25] [--speed 15] [--report]

Records half laps of both tracks by the expert and by someone at a keyboard, and other drives that no network
learns from; trains each recipe with each seed, and takes the network of each of these epochs; lets each predict
the recordings held out, and drive the simulator (`bc-eval --simulator`).

What FOLDER has already is not made again: stop it (Ctrl-C) and start it again as often as you like. Every job has
one thread, and --jobs of them run at once. At the end, or at any time with --report alone, which_number_report.py
makes the parquet, the table and the figure of what is there.
"""

from __future__ import annotations

import argparse
import itertools
import os
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

from common.files import atomic_file

KNOWN: Final = ("lake", "mountain")
HELD_OUT_ROADS: Final = ("random:101", "random:102", "random:103")  # recorded, and predicted
DRIVEN: Final = (*KNOWN, "random:1", "random:2", "random:3", "random:4", "random:5")
EPOCHS: Final = (1, 4)
PREDICT: Final = Path(__file__).resolve().with_name("which_number_predict.py")
LEARNT_SEED, HELD_OUT_SEED = 1, 2
RECORDED_LAPS: Final = {LEARNT_SEED: 0.5, HELD_OUT_SEED: 0.25}

SMALL: Final = ("--per-bin", "150")  # 3,750 samples an epoch: half a minute for four
ORIGINAL: Final = ("--recipe", "original")
PEOPLE: Final = ("--recipe", "people")


@dataclass(frozen=True)
class Recipe:
    """How networks of one kind come about; all learn from as many samples, but for the tenth."""

    index: tuple[str, ...]
    train: tuple[str, ...]
    driver: str = "keyboard"


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
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--jobs", type=int, default=2, help="how many run at once, of one thread each")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--epochs", type=int, nargs="+", default=list(EPOCHS))
    parser.add_argument("--laps", type=float, default=0.25, help="how far to drive on each track")
    parser.add_argument("--speed", type=float, default=15.0, help="how fast, in mph")
    parser.add_argument("--recipes", nargs="+", choices=RECIPES, default=list(RECIPES))
    parser.add_argument("--report", action="store_true", help="only the report of what is there")
    arguments = parser.parse_args()
    folder = arguments.folder.resolve()
    if not arguments.report:
        study = Study(folder, arguments.epochs, arguments.laps, arguments.speed)
        trainings = list(itertools.product(arguments.seeds, arguments.recipes))  # so that all recipes come early
        with Jobs(arguments.jobs) as jobs:
            study.jobs = jobs
            jobs.each(lambda one: study.record(*one), [*study.learnt_drives(), *study.held_out_drives()])
            jobs.each(study.index, arguments.recipes)
            trained = jobs.each(lambda one: study.train(*one), trainings)
            networks = [network for epoch in reversed(list(zip(*trained, strict=True))) for network in epoch]
            steps = (study.predict, study.drive)
            jobs.each(lambda step: step[1](step[0]), list(itertools.product(networks, steps)))
    report.write(folder)


class Jobs:
    """Runs commands, some at once. What goes wrong in one, or a signal, ends all."""

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
                process.terminate()  # these end whole: what they have not finished, they make again
        self._pool.shutdown(cancel_futures=True)

    def each(self, work: Callable[[Any], Any], of: Iterable[Any]) -> list[Any]:
        """The results of a job for each, in their order."""
        futures = [self._pool.submit(work, one) for one in of]
        done, _ = wait(futures, return_when=FIRST_EXCEPTION)
        for future in done:
            future.result()
        return [future.result() for future in futures]

    def bc(self, folder: Path, name: str, *arguments: object) -> str:
        """Run a `bc-` command in the folder; what it prints."""
        code = f"from behavioural_cloning_toolkit import bc_{name}; bc_{name}()"
        return self.run(folder, f"bc-{name}", ["-c", code], *arguments)

    def run(self, folder: Path, name: str, program: Sequence[str], *arguments: object) -> str:
        """Run Python in the folder, with one thread; what it prints."""
        words = [str(argument) for argument in arguments]
        told = f"{name} {' '.join(words)}"
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        begin_s = time.monotonic()
        with self._lock:
            if self._is_over:
                raise SystemExit(1)
            process = subprocess.Popen(
                [sys.executable, *program, *words],
                cwd=folder,
                env=environment,
                text=True,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C reaches only us
            )
            self._running.add(process)
        output, errors = process.communicate()
        with self._lock:
            self._running.discard(process)
        if process.returncode not in (0, 3):
            raise SystemExit(f"{told}: exit code {process.returncode}\n{errors}")
        print(f"{time.monotonic() - begin_s:6.1f} s  {told}", file=sys.stderr, flush=True)
        return str(output)


class Study:
    """The steps. Each leaves a file or folder that shows that it is done."""

    jobs: Jobs

    def __init__(self, folder: Path, epochs: Sequence[int], laps: float, speed_mph: float) -> None:
        self.folder = folder
        self.epochs = sorted(epochs)
        self.laps = laps
        self.speed_mph = speed_mph
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
        if not log.exists():  # one that is stopped is finished as far as it has come: it lies elsewhere until then
            flags = ("--track", track, "--driver", driver, "--laps", RECORDED_LAPS[seed], "--seed", seed)
            # a person who is recorded to be measured by is not pushed off the line now and then
            recovery = ("--recovery", 0) if seed == HELD_OUT_SEED and driver == "keyboard" else ()
            self.jobs.bc(self.folder, "record", name, *flags, *recovery, "--sessions", "unfinished", "--force")
            (self.folder / "unfinished" / log.name).rename(log)

    def index(self, name: str) -> None:
        recipe = RECIPES[name]
        index = self.folder / "indexes" / file_name(name)
        if not (index / "samples.parquet").exists():
            sessions = [session(track, recipe.driver, LEARNT_SEED) for track in KNOWN]
            self.jobs.bc(self.folder, "index", *sessions, "--index", index, *recipe.index)

    def train(self, seed: int, name: str) -> list[str]:
        """Train some epochs, take the network, go on; the names of the networks."""
        training = f"{file_name(name)}-s{seed}"
        for epochs in self.epochs:
            taken = self.folder / "networks" / f"{training}-e{epochs}"
            if not taken.exists():
                self._train(name, seed, training, epochs)
                self._take(training, taken)
        return [f"{training}-e{epochs}" for epochs in self.epochs]

    def _train(self, name: str, seed: int, training: str, epochs: int) -> None:
        run = self.folder / "runs" / training
        how = ("--epochs", epochs, "--threads", 1, "--device", "cpu")
        if run.exists():
            self.jobs.bc(self.folder, "train", "--resume", training, *how)
        else:
            index = ("--index", self.folder / "indexes" / file_name(name))
            flags = (*RECIPES[name].train, "--keep", "last", "--seed", seed)
            self.jobs.bc(self.folder, "train", "--name", training, *index, *flags, *how)

    def _take(self, training: str, taken: Path) -> None:
        """Copy a run without its checkpoint: what drives, and what it has learnt from."""
        part = taken.with_name(f"{taken.name}.part")
        shutil.rmtree(part, ignore_errors=True)
        shutil.copytree(self.folder / "runs" / training, part, ignore=shutil.ignore_patterns("last"))
        part.rename(taken)

    def predict(self, network: str) -> None:
        """Keep what the network predicts of every held-out frame: any offline measure is made of that."""
        kept = self.folder / "predictions" / f"{network}.parquet"
        if kept.exists():
            return
        logs = [self.folder / "sessions" / f"{session(*drive)}.mcap" for drive in self.held_out_drives()]
        self.jobs.run(self.folder, "predict", [str(PREDICT)], self.folder / "networks" / network, kept, *logs)

    def drive(self, network: str) -> None:
        """Drive the simulator. The logs, 100 MB each, are not kept."""
        kept = self.folder / "driven" / f"{network}.jsonl"
        if kept.exists():
            return
        with tempfile.TemporaryDirectory(dir=self.folder / "drives") as logs:
            flags = ("--simulator", *DRIVEN, "--laps", self.laps, "--speed", self.speed_mph)
            told = self.jobs.bc(
                self.folder, "eval", network, "--runs", "networks", *flags, "--drives", logs, "--json"
            )
        with atomic_file(kept, overwrite=True) as part:
            part.write_text(told)


def session(track: str, driver: str, seed: int) -> str:
    return f"{track.replace(':', '-')}-{driver}-{seed}"


def file_name(recipe: str) -> str:
    return recipe.replace(" + ", "+").replace(", ", "-").replace(" ", "_")


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("stopped; the same command goes on from here")
