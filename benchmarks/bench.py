"""The training step, the index and the reply of a drive, beside what they have been on this kind of processor.

python benchmarks/bench.py            # make bench: five minutes; exit code 1 if something takes 10 % more
python benchmarks/bench.py --keep     # keeps these figures for this kind of processor

benchmarks/kept_figures.json has the kept ones. Each figure is the best of its rounds, by processor time: whatever
else a machine does only slows it. The rounds take turns, so that a slow minute meets all of them. What looks
slower is measured once more. A wait is not found: it takes no processor time.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

os.environ["THP_MEM_ALLOC_ENABLE"] = "1"  # as bc-train has it: before PyTorch is imported

import torch
from driving_servers import start_ours, write_pictures
from indexing import write_log

from dataset import IndexConfig, build_index
from model.adam import Adam
from model.config import TrainConfig
from model.device import choose_machine
from model.network.original import SteeringNetwork
from model.training.step import training_step

sys.path.append(str(Path(__file__).parents[1] / "tests/helpers"))
from driving import untrained_run

KEPT: Final = Path(__file__).with_name("kept_figures.json")
MOVED: Final = 0.07  # 10 % more time is 9 % fewer a second
ROUNDS: Final = 5
BATCHES: Final = 4  # of 256, in a round
ROWS: Final = 20_000  # of the log that is indexed
REPLIES: Final = 1_500  # in a round
UNITS: Final = {"training step": "samples", "index": "frames", "reply": "replies"}  # a second of processor time


def processor() -> str:
    """Its name, what it multiplies with, and how many cores this process may use."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    about = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    flags = set(about.get("flags", "").split())
    units = [name for name in ("avx2", "avx512f", "avx512_bf16", "amx_bf16") if name in flags]
    return f"{about.get('model name', 'unknown')}, {' '.join(units)}, {len(os.sched_getaffinity(0))} cores"


def train_steps() -> Callable[[], float]:
    """The default network learns random pictures in memory."""
    config = TrainConfig()
    machine = choose_machine(config)
    network = SteeringNetwork(config.dropout).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = Adam(network.parameters(), config.rate)
    pictures = torch.randint(0, 256, (config.batch, 128, 128, 3), dtype=torch.uint8).permute(0, 3, 1, 2)
    steering = torch.rand(config.batch) * 2 - 1
    network.train()

    def round_of() -> float:
        begin_s = time.process_time()
        for _ in range(BATCHES):
            training_step(
                network, optimizer, pictures, steering, dtype=machine.dtype, micro_batch=machine.micro_batch
            )
        return BATCHES * config.batch / (time.process_time() - begin_s)

    return round_of


def index_log(folder: Path) -> Callable[[], float]:
    """A log of three cameras is indexed anew, with balanced samples."""
    log = write_log(folder, ROWS, 0)
    rounds = iter(range(ROUNDS + 1))

    def round_of() -> float:
        begin_s = time.process_time()
        made = build_index([log], folder / f"index{next(rounds)}", IndexConfig())
        taken_s = time.process_time() - begin_s
        return sum(counts.frames for counts in made.counts.values()) / taken_s

    return round_of


@contextmanager
def answer(folder: Path) -> Iterator[Callable[[], float]]:
    """`bc-drive` with the default network answers a client with one telemetry in flight."""
    pictures = folder / "pictures"
    pictures.mkdir()
    write_pictures(None, pictures)
    with ExitStack() as stack:
        server = start_ours(
            "bc-drive", untrained_run(folder / "run", network="original"), folder / "drive.mcap", stack
        )
        server.suspend()

        def round_of() -> float:
            begin = server.process.cpu_times()
            turn = server.drive(pictures, REPLIES, 60.0)
            end = server.process.cpu_times()
            used_s = float(end.user + end.system - begin.user - begin.system)
            return len(turn.round_trips_ms) / used_s

        yield round_of


def measure() -> dict[str, float]:
    with tempfile.TemporaryDirectory(prefix="bc-bench-") as name, answer(Path(name)) as reply:
        rounds = {"training step": train_steps(), "index": index_log(Path(name)), "reply": reply}
        rates_of: dict[str, list[float]] = {what: [] for what in rounds}
        for _ in range(ROUNDS + 1):
            for what, round_of in rounds.items():
                rates_of[what].append(round_of())
    for what, rates in rates_of.items():
        shown = ", ".join(f"{rate:,.0f}" for rate in sorted(rates[1:]))
        print(f"{what}: {shown} (median {statistics.median(rates[1:]):,.0f})", file=sys.stderr)
    return {what: max(rates[1:]) for what, rates in rates_of.items()}  # the first warms up


def slower(rates: dict[str, float], kept: dict[str, float]) -> list[str]:
    return [what for what, rate in rates.items() if what in kept and rate < (1 - MOVED) * kept[what]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", action="store_true", help="keep the figures for this kind of processor")
    arguments = parser.parse_args()
    kind = processor()
    all_kept = json.loads(KEPT.read_text(encoding="utf-8"))
    kept: dict[str, float] = all_kept.get(kind, {})
    rates = measure()
    if slower(rates, kept):
        again = measure()
        rates = {what: max(rate, again[what]) for what, rate in rates.items()}
    print(f"{kind}:\n\n| a second of processor time | now | kept | ratio | |\n|---|---|---|---|---|")
    for what, rate in rates.items():
        if what not in kept:
            print(f"| {what}, {UNITS[what]} | {rate:,.0f} | - | - | nothing kept: --keep |")
            continue
        ratio = rate / kept[what]
        moved = "**slower**" if what in slower(rates, kept) else "faster: --keep" if ratio > 1 + MOVED else ""
        print(f"| {what}, {UNITS[what]} | {rate:,.0f} | {kept[what]:,.0f} | {ratio:.2f} | {moved} |")
    if arguments.keep:
        all_kept[kind] = {what: round(rate) for what, rate in rates.items()}
        KEPT.write_text(json.dumps(all_kept, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    raise SystemExit(int(bool(slower(rates, kept))))


if __name__ == "__main__":
    main()
