"""What a sample costs to learn, in this version and in an earlier one.

git worktree add ../before COMMIT
python benchmarks/training_versions.py INDEX --before ../before [--rounds 4]

Each trains two epochs of the same samples of INDEX in a process of its own, with all cores; the second epoch
counts. Given are samples a second, the median of the rounds (least to most), and the median of the ratio to the
earlier version within each round. A machine that does nothing else is needed.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

HERE: Final = Path(__file__).resolve().parent.parent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("index", type=Path)
    parser.add_argument("--before", type=Path, required=True, help="a checkout of the earlier version")
    parser.add_argument("--rounds", type=int, default=4)
    arguments = parser.parse_args()
    ways = {
        "before": (arguments.before.resolve(), ()),
        "now, --recipe original": (HERE, ("--recipe", "original")),
        "now": (HERE, ()),
    }
    rates: dict[str, list[float]] = {way: [] for way in ways}
    for number in range(arguments.rounds):
        for way, (sources, flags) in ways.items():
            rates[way].append(samples_per_s(sources, arguments.index.resolve(), flags))
            print(f"round {number + 1}, {way}: {rates[way][-1]:.0f}", file=sys.stderr, flush=True)
    print("| | samples/s | of the earlier version's |\n|---|---|---|")
    for way, found in rates.items():
        ratio = statistics.median(now / before for now, before in zip(found, rates["before"], strict=True))
        print(f"| {way} | {statistics.median(found):.0f} ({min(found):.0f} to {max(found):.0f}) | {ratio:.2f} |")


def samples_per_s(sources: Path, index: Path, flags: tuple[str, ...]) -> float:
    """That of the second epoch."""
    code = "from behavioural_cloning_toolkit import bc_train; bc_train()"
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, "-P", "-c", code, "--index", str(index), "--name", "run", "--epochs", "2", *flags],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(sources)},
            check=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        lines = (Path(folder) / "runs" / "run" / "metrics.jsonl").read_text().splitlines()
    return float(json.loads(lines[1])["samples_per_s"])


if __name__ == "__main__":
    main()
