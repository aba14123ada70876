"""How fast the network is trained on a processor, compared with the step alone, Keras, and simple PyTorch.

python -m venv keras && keras/bin/pip install tensorflow-cpu opencv-python-headless
python benchmarks/training.py INDEX --keras-python keras/bin/python [--threads 1] [--only bc-train Keras]

All contenders learn the same samples of INDEX, each in a separate process with the same number of threads (by
default one a core): `bc-train` in its default batches, the others in batches of 256. They take turns; a turn is an
epoch. The first round warms up and is not counted. Only `bc-train` alters copies: the others get unaltered ones.
The time to a network that drives is that of the samples after which it drives, at the measured speed. Needs 16 GB
of memory with Keras, and an otherwise idle machine.
"""

from __future__ import annotations

import argparse
import csv
import os
import statistics
import subprocess
import sys
import tempfile
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Final

import numpy as np

from common.location import local_path
from dataset import Samples
from dataset.parquet_file import write_table
from dataset.samples.samples_format import SAMPLES_NAME

HERE: Final = Path(__file__).parent
STEP: Final = "our step alone, on random pictures in memory"
OURS: Final = {
    "`bc-train`": ["train", "--recipe", "large-steps"],
    "`bc-train --recipe altered`": ["train"],
    "`bc-train --picture-memory-mb 0`: every picture is decoded": ["train", "--picture-memory-mb", "0"],
    STEP: ["step"],
    "our step alone, micro-batches of 16": ["step", "--micro-batch", "16"],
    "our step alone, micro-batches of 32": ["step", "--micro-batch", "32"],
    "our step alone, micro-batches of 64": ["step", "--micro-batch", "64"],
    "our step alone, micro-batches of 128": ["step", "--micro-batch", "128"],
    "our step alone, 256 at once": ["step", "--micro-batch", "256"],
    "our step alone, float32": ["step", "--precision", "float32"],
    "PyTorch as first written": ["plain"],
}
KERAS_SETTINGS: Final = {
    "Keras, `fit`": [],  # with its defaults: what the original used
    "Keras, `mixed_bfloat16`": ["--precision", "mixed_bfloat16"],
    "Keras, not compiled by XLA": ["--no-xla"],
    "Keras, `mixed_bfloat16`, not compiled by XLA": ["--precision", "mixed_bfloat16", "--no-xla"],
}


DRIVES_AFTER: Final = {
    "`bc-train`": 10_470,
    "`bc-train --recipe altered`": 4 * 10_470,
    **dict.fromkeys(KERAS_SETTINGS, 10 * 10_470),
}
"""Samples of half a lap of both tracks after which a network drives them: one and four passes
(docs/studies/speedrun.md), and the original project's ten."""


@dataclass
class Contender:
    """A process that trains an epoch for each line on its stdin."""

    name: str
    process: subprocess.Popen[str]
    errors: IO[str]
    seconds: list[float] = field(default_factory=list)  # of each epoch

    def train_epoch(self) -> float:
        """Let the contender train an epoch. Returns its seconds."""
        with suppress(BrokenPipeError):  # the process has ended: the missing answer is reported below
            print("go", file=self.process.stdin, flush=True)
        answer = self.process.stdout.readline() if self.process.stdout else ""
        if not answer:
            self.process.wait()
            self.errors.seek(0)
            last_errors = self.errors.read()[-2000:]
            raise SystemExit(f"{self.name}: ended with code {self.process.returncode}\n{last_errors}")
        self.seconds.append(float(answer))
        return self.seconds[-1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("index", type=Path)
    parser.add_argument("--keras-python", help="the Python of an environment with TensorFlow; without, no Keras")
    parser.add_argument("--rounds", type=int, default=3, help="turns of each contender that count")
    parser.add_argument("--samples", type=int, default=2560, help="training samples in an epoch")
    parser.add_argument("--threads", type=int, default=0, help="threads of each contender; 0: one a core")
    parser.add_argument(
        "--only", nargs="+", default=[""], metavar="WORDS", help="only contenders with these names"
    )
    chosen = parser.parse_args()
    commands = {name: [sys.executable, "training_torch.py", *arguments] for name, arguments in OURS.items()}
    if chosen.keras_python:
        refuse_without_keras(chosen.keras_python)
        keras = {name: [chosen.keras_python, "training_keras.py", *more] for name, more in KERAS_SETTINGS.items()}
        commands |= keras
    else:
        print("Keras is left out: --keras-python says where it is installed", file=sys.stderr)
    threads = ["--threads", str(chosen.threads)]
    commands = {
        name: [*command, *threads]
        for name, command in commands.items()
        if any(words in name for words in chosen.only)
    }
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        count = write_pictures(chosen.index, Path(name), chosen.samples)
        contenders: dict[str, Contender] = {}
        for number in range(1 + chosen.rounds):
            for what, command in commands.items():
                if what not in contenders:  # started in its first turn: a start would disturb the others
                    contenders[what] = start(what, command, Path(name), stack)
                seconds = contenders[what].train_epoch()
                print(f"round {number}: {what}: {count / seconds:,.0f} samples/s", file=sys.stderr)
        print(f"{count:,} samples, {chosen.rounds} rounds, {chosen.threads or os.cpu_count()} threads\n")
        print_table({what: [count / s for s in contender.seconds] for what, contender in contenders.items()})


def refuse_without_keras(python: str) -> None:
    """End with a line if this Python does not exist, or lacks Keras."""
    try:
        subprocess.run([python, "-c", "import cv2, keras"], capture_output=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        raise SystemExit(
            f"{python}: no Python with Keras; `{Path(__file__).name} --help` says how to make one"
        ) from None


def write_pictures(index: Path, folder: Path, count: int) -> int:
    """Write some training samples of `index` to `folder`: as an index, and as JPEG files with a list. Returns
    their number."""
    (folder / "index").mkdir()
    with Samples(index) as samples, (folder / "samples.csv").open("w", newline="") as stream:
        table = samples.of_split("train")
        table = table.take(np.sort(np.random.default_rng(0).permutation(len(table))[:count]))
        logs = {
            session: {"log": str(local_path(log.path).absolute()), "fingerprint": log.fingerprint}
            for session, log in samples.logs.items()
        }
        write_table(folder / "index" / SAMPLES_NAME, table, {**samples.metadata, "logs": logs})
        listed = csv.writer(stream)
        for number, row in enumerate(table.to_pylist()):
            jpeg = samples.logs[row["session"]].read(row["offset"], row["length"], row["chunk"])
            (folder / f"{number:06}.jpg").write_bytes(jpeg)
            listed.writerow([f"{number:06}.jpg", int(row["flip"]), row["label"]])
    return len(table)


def start(name: str, command: list[str], folder: Path, stack: ExitStack) -> Contender:
    """Start a contender, which waits for its first turn and ends with `stack`."""
    python, script, *arguments = command
    errors = stack.enter_context(tempfile.TemporaryFile("w+"))  # noqa: SIM115
    pages = {} if "plain" in arguments else {"THP_MEM_ALLOC_ENABLE": "1"}  # as in bc-train
    process = stack.enter_context(
        subprocess.Popen(
            [python, HERE / script, folder, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            env={**os.environ, **pages},
            text=True,
        )
    )
    return Contender(name, process, errors)


def print_table(rates: dict[str, list[float]]) -> None:
    """Print medians (minimum to maximum) of samples/s, of their ratios to the step alone in the same round, and of
    their ratios to the best rate of Keras in any round with any setting, so that a disturbed round of Keras does
    not flatter the others."""
    keras = max((rate for name in KERAS_SETTINGS for rate in rates.get(name, [])[1:]), default=None)
    print("| | samples/s | to the step alone | to Keras' best round of all | drives after |")
    print("|---|---|---|---|---|")
    for name, (first, *rest) in rates.items():
        step = [rate / limit for rate, limit in zip(rest, rates[STEP][1:], strict=True)] if STEP in rates else []
        against = [
            spread(ratios, ".2f") if ratios else "-" for ratios in (step, [rate / keras for rate in rest if keras])
        ]
        if name == "`bc-train`":
            print(f"| `bc-train`, its first epoch: CRCs, decoding, warming up | {first:,.0f} | - | - | - |")
        samples = DRIVES_AFTER.get(name)
        drives = "-" if samples is None else f"{samples / statistics.median(rest):,.0f} s"
        print(f"| {name} | {spread(rest, ',.0f')} | {' | '.join(against)} | {drives} |")


def spread(values: list[float], form: str) -> str:
    return f"{statistics.median(values):{form}} ({min(values):{form}} to {max(values):{form}})"


if __name__ == "__main__":
    main()
