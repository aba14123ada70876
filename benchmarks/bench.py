"""Does the training step, the index or the reply of a drive take 10 % more time than in an earlier version?

python benchmarks/bench.py                  # make bench; exit code 1 if something takes longer
python benchmarks/bench.py --base COMMIT    # compares with this commit; else with that in bench_base.txt

Both versions do the same work at the same time on the same core. The scheduler changes between them every few
milliseconds, so that whatever else the machine does slows both. A ratio is that of their processor times, and the
median over all rounds. What looks slower is measured again. Waiting takes no processor time and is not noticed.
"""

from __future__ import annotations

import argparse
import math
import os
import statistics
import subprocess
import sys
import tarfile
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from common.progress import track

ROOT: Final = Path(__file__).parents[1]
BASE: Final = Path(__file__).with_name("bench_base.txt")
WORKER: Final = "benchmarks/bench_worker.py"
UNITS: Final = {"training step": "samples", "index": "frames", "reply": "replies"}
LIMIT: Final = 1.06  # a ratio whose whole interval is above it counts; 1.10 less what intervals were wide
STARTS: Final = 5  # of each version's process: two of the same version can differ by 1 %
ROUNDS: Final = 5  # after each start

Rates = tuple[float, float]  # of now and of the base, per second of processor time


def git(*arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(
            f"git {' '.join(arguments)}: {done.stderr.strip()}\nThe base must be a commit of this clone. In a"
            " shallow clone, run `git fetch --unshallow` first, or give another with --base COMMIT."
        )
    return done.stdout.strip()


def check_out(commit: str, folder: Path) -> Path:
    """The files of a commit in `folder`/tree."""
    git("archive", "--output", str(folder / "tree.tar"), commit)
    with tarfile.open(folder / "tree.tar") as archive:
        archive.extractall(folder / "tree", filter="data")
    return folder / "tree"


def start(tree: Path, inputs: Path, core: int, stack: ExitStack) -> subprocess.Popen[str]:
    """A process that works with the version in `tree`; it ends with `stack`."""
    own = tree / WORKER  # what calls a version changes with it; a version before the first worker has none
    line = [sys.executable, str(own if own.exists() else ROOT / WORKER), str(inputs)]
    path = os.pathsep.join([str(tree), str(tree / "tests" / "helpers")])
    environment = {"PYTHONPATH": path, "PYTHONHASHSEED": "0", "OMP_NUM_THREADS": "1"}
    environment["THP_MEM_ALLOC_ENABLE"] = "1"  # as bc-train has it
    process = subprocess.Popen(
        line,
        cwd=inputs,
        env={**os.environ, **environment},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,  # Ctrl-C ends this process, which then ends that one
    )
    stack.callback(process.wait)
    stack.callback(process.terminate)
    os.sched_setaffinity(process.pid, {core})
    return process


def work(processes: Sequence[subprocess.Popen[str]], what: str) -> Iterator[float]:
    """Let all work at the same time; their rates."""
    for process in processes:
        print(what, file=process.stdin, flush=True)
    for process in processes:
        answer = process.stdout.readline() if process.stdout else ""
        if not answer:
            raise SystemExit(f"{' '.join(map(str, process.args))}: it failed")  # type: ignore[arg-type]
        yield float(answer)


def measure(trees: Sequence[Path], folders: Sequence[Path], figures: Sequence[str]) -> dict[str, list[Rates]]:
    """The rates of all rounds, of each figure."""

    def rounds() -> Iterator[tuple[str, Rates]]:
        cores = sorted(os.sched_getaffinity(0))
        for number in range(STARTS):
            core = cores[number % len(cores)]
            with ExitStack() as stack:
                workers = [start(*places, core, stack) for places in zip(trees, folders, strict=True)]
                for what in figures:
                    list(work(workers, what))  # warms up
                    for _ in range(ROUNDS):
                        now, base = work(workers, what)
                        yield what, (now, base)

    rates_of = defaultdict(list)
    for what, rates in track(rounds(), f"Measuring {', '.join(figures)}", STARTS * ROUNDS * len(figures)):
        rates_of[what].append(rates)
    return rates_of


def interval(rates: Sequence[Rates]) -> tuple[float, float, float]:
    """The time of now as a multiple of the base's: lower bound, median, upper bound (95 %, by the sign test)."""
    ratios = sorted(base / now for now, base in rates)
    left_out = max(0, int(len(ratios) / 2 - 0.98 * math.sqrt(len(ratios))))
    return ratios[left_out], statistics.median(ratios), ratios[-1 - left_out]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--base", metavar="COMMIT", default=BASE.read_text(encoding="utf-8").strip())
    arguments = parser.parse_args()
    name_of_base = git("log", "-1", "--format=%h of %cs (%s)", arguments.base)
    with tempfile.TemporaryDirectory(prefix="bc-bench-") as name:
        folders = [Path(name) / "now", Path(name) / "base"]
        for folder in folders:
            folder.mkdir()
        trees = [ROOT, check_out(arguments.base, folders[1])]
        rates_of = measure(trees, folders, list(UNITS))
        if again := [what for what, rates in rates_of.items() if interval(rates)[1] > LIMIT]:
            for what, rates in measure(trees, folders, again).items():
                rates_of[what] += rates
    print(f"The base is {name_of_base}.\n")
    print("| per second of processor time | now | base | time, of the base's | |\n|---|---|---|---|---|")
    slower = False
    for what, rates in rates_of.items():
        if os.environ.get("BENCH_RAW"):
            print(what, [round(b / n, 3) for n, b in rates], file=sys.stderr)
        now, base = (statistics.median(of) for of in zip(*rates, strict=True))
        low, ratio, high = interval(rates)
        slower |= low > LIMIT
        verdict = "**slower**" if low > LIMIT else "faster" if high < 1 / LIMIT else ""
        bounds = f"{low:.3f} to {high:.3f}"
        print(f"| {what}, {UNITS[what]} | {now:,.0f} | {base:,.0f} | {ratio:.3f} ({bounds}) | {verdict} |")
    raise SystemExit(int(slower))


if __name__ == "__main__":
    main()
