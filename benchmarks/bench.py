"""Does the training step, the index or the reply of a drive take 10 % more time than in an earlier version?

python benchmarks/bench.py                  # make bench, five minutes; exit code 1 if something takes longer
python benchmarks/bench.py --base COMMIT    # the version to compare with; by default that of bench_base.txt

Both versions do the same work at the same time on the same core. The scheduler changes between them every few
milliseconds, so other programs slow both alike. A ratio is the median of all rounds, with the interval (95 %) of
the sign test. Figures that look slower are measured again. Only processor time on one thread counts. Needs Linux.
"""

from __future__ import annotations

import argparse
import itertools
import math
import os
import signal
import statistics
import subprocess
import sys
import tarfile
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import torch
from driving_client import OneInFlight
from driving_servers import start_ours, write_pictures
from indexing import write_log

from common.progress import track
from dataset import IndexConfig, build_index
from model.adam import Adam
from model.config import TrainConfig
from model.device import choose_machine
from model.network.pilotnet import SteeringNetwork
from model.training.step import training_step
from simulator.protocol.client import SimulatorClient

ROOT: Final = Path(__file__).parents[1]
LIMIT: Final = 1.06  # for the lower bound of a ratio: intervals reach 2 % below a ratio, and 1.10 must be detected
STARTS: Final = 4  # of each version's process, on alternating cores
WARM_UP: Final = 3  # rounds after each start: the first training steps wait for memory
ROUNDS: Final = 8
SAMPLES, INDEXES, REPLIES = 32, 4, 40  # in a round
ROWS: Final = 2_000  # of the log that is indexed


def training(*_: object) -> Iterator[float]:
    """Train the default network on random pictures in memory. Yields samples per second."""
    config = TrainConfig(device="cpu")
    dtype = choose_machine(config).dtype
    network = SteeringNetwork(config.dropout, standardized=True).train().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = Adam(network.parameters(), config.rate)
    pictures = torch.randint(0, 256, (SAMPLES, 128, 128, 3), dtype=torch.uint8).permute(0, 3, 1, 2)
    steering = torch.rand(SAMPLES) * 2 - 1
    while True:
        begin_s = time.process_time()
        training_step(network, optimizer, pictures, steering, dtype=dtype, micro_batch=SAMPLES)
        yield SAMPLES / (time.process_time() - begin_s)


def indexing(inputs: Path, scratch: Path, _: object) -> Iterator[float]:
    """Index a log of three cameras, with balanced samples. Yields rows per second."""
    log = write_log(inputs, ROWS, 0)
    numbers = itertools.count()
    while True:
        begin_s = time.process_time()
        for _ in range(INDEXES):
            build_index([log], scratch / f"index{next(numbers)}", IndexConfig())
        yield INDEXES * ROWS / (time.process_time() - begin_s)


def replying(inputs: Path, scratch: Path, stack: ExitStack) -> Iterator[float]:
    """Let `bc-drive` with the default network answer a client with one message in flight. Yields replies per
    second."""
    from tests.helpers.driving import untrained_run

    if not any(inputs.glob("*.jpg")):
        write_pictures(None, inputs)
    pictures = [path.read_bytes() for path in sorted(inputs.glob("*.jpg"))]
    run = untrained_run(scratch / "run", network="original")
    server = start_ours("bc-drive", run, scratch / "drive.mcap", stack)
    clock = ~server.process.pid << 3 | 2  # of the processor time of all its threads: Linux's clock_getcpuclockid
    while True:
        begin_s = time.clock_gettime(clock)
        SimulatorClient(port=server.port).run(OneInFlight(pictures, REPLIES, float("inf")).next_telemetry)
        yield REPLIES / (time.clock_gettime(clock) - begin_s)


FIGURES: Final[dict[str, Callable[[Path, Path, ExitStack], Iterator[float]]]] = {
    "training step, samples": training,
    "index, rows": indexing,
    "reply, replies": replying,
}


def serve(inputs: Path) -> None:
    """Do a round of each figure that stdin names, and print its rate per second of processor time."""
    inputs.mkdir(exist_ok=True)
    works: dict[str, Iterator[float]] = {}
    with tempfile.TemporaryDirectory(dir=inputs) as scratch, ExitStack() as stack:
        for figure in map(str.strip, sys.stdin):
            if figure not in works:
                works[figure] = FIGURES[figure](inputs, Path(scratch), stack)
            print(next(works[figure]), flush=True)


def check_out(commit: str, folder: Path) -> None:
    """Write the files of a commit to a folder."""
    line = ["git", "-C", str(ROOT), "archive", f"--output={folder}.tar", commit]
    if subprocess.run(line, check=False).returncode:
        raise SystemExit(f"{commit} is not in this clone: run `git fetch --unshallow`, or give --base COMMIT")
    with tarfile.open(f"{folder}.tar") as archive:
        archive.extractall(folder, filter="data")


def start(tree: Path, inputs: Path, core: int, stack: ExitStack) -> subprocess.Popen[str]:
    """Start a process that works with the version in `tree`, and ends with `stack`."""
    script = tree / "benchmarks" / "bench.py"  # each version's own script knows how to call it
    path = {"PYTHONPATH": f"{tree}{os.pathsep}{tree / 'tests' / 'helpers'}"}
    fixed = {"PYTHONHASHSEED": "0", "OMP_NUM_THREADS": "1", "THP_MEM_ALLOC_ENABLE": "1"}  # its pages: bc-train's
    process = subprocess.Popen(
        [sys.executable, script, "--serve", inputs],
        cwd=inputs.parent,  # else `python -c`, which starts the server, imports from the current folder
        env={**os.environ, **path, **fixed},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,  # Ctrl-C reaches only this process, which ends the others
    )
    stack.callback(process.wait)
    stack.callback(process.terminate)
    os.sched_setaffinity(process.pid, {core})
    return process


def work(processes: Sequence[subprocess.Popen[str]], figure: str) -> list[float]:
    """Let all processes work at the same time. Returns their rates per second of processor time."""
    for process in processes:
        print(figure, file=process.stdin, flush=True)
    answers = [process.stdout.readline() if process.stdout else "" for process in processes]
    if not all(answers):
        raise SystemExit(f"{figure}: a version failed")
    return [float(answer) for answer in answers]


def measure(trees: Sequence[Path], folder: Path, figures: Sequence[str]) -> Iterator[tuple[str, list[float]]]:
    """Yields, for each round, the figure and the rates of the `trees`."""
    cores = sorted(os.sched_getaffinity(0))
    for number in range(STARTS):
        with ExitStack() as stack:
            core = cores[number % len(cores)]
            processes = [start(tree, folder / str(at), core, stack) for at, tree in enumerate(trees)]
            for figure in figures:
                for _ in range(WARM_UP):
                    work(processes, figure)
                yield from ((figure, work(processes, figure)) for _ in range(ROUNDS))


def interval(rates: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """The present version's time divided by the base's: lower bound, median, upper bound."""
    ratios = sorted(base / now for now, base in rates)
    beyond = max(0, int(len(ratios) / 2 - 0.98 * math.sqrt(len(ratios))))
    return ratios[beyond], statistics.median(ratios), ratios[-1 - beyond]


def main() -> None:
    for stop in (signal.SIGINT, signal.SIGTERM):
        signal.signal(stop, lambda *_: sys.exit(130))  # an exit removes the temporary folder
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kept = Path(__file__).with_name("bench_base.txt").read_text(encoding="utf-8").strip()
    parser.add_argument("--base", metavar="COMMIT", default=kept, help="commit to compare with (%(default)s)")
    parser.add_argument("--serve", metavar="FOLDER", type=Path, help=argparse.SUPPRESS)  # one version's process
    arguments = parser.parse_args()
    if arguments.serve:
        serve(arguments.serve)
        return
    rates_of = defaultdict(list)
    with tempfile.TemporaryDirectory(prefix="bc-bench-") as name:
        folder = Path(name)
        check_out(arguments.base, folder / "base")
        figures = list(FIGURES)
        for doing in ("Measuring", "Measuring again"):
            rounds = measure([ROOT, folder / "base"], folder, figures)
            for figure, rates in track(rounds, doing, STARTS * ROUNDS * len(figures)):
                rates_of[figure].append(rates)
            figures = [figure for figure in figures if interval(rates_of[figure])[1] > LIMIT]
            if not figures:
                break
    print(f"The base is {arguments.base}.\n")
    print("| per second of processor time | now | base | time now / base | |\n|---|---|---|---|---|")
    for figure, all_rates in rates_of.items():
        now, before = map(statistics.median, zip(*all_rates, strict=True))
        low, ratio, high = interval(all_rates)
        verdict = "**slower**" if low > LIMIT else "faster" if high < 1 / LIMIT else ""
        shown = f"{ratio:.3f} ({low:.3f} to {high:.3f})"
        print(f"| {figure} | {now:,.0f} | {before:,.0f} | {shown} | {verdict} |")
    raise SystemExit(any(interval(all_rates)[0] > LIMIT for all_rates in rates_of.values()))


if __name__ == "__main__":
    main()
