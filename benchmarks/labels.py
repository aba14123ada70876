"""What it brings to smooth the labels of people, or to take them later.

python benchmarks/labels.py sessions/lake.mcap sessions/jungle.mcap [--smooth 0.5] [--shift 0.2] [--epochs 10]
    [--seeds 0 1 2]

Trains a network for each kind of label and each seed, on the same frames of all the logs together, and measures
every one on the same held-out blocks: against the steering as it was recorded, and against two guesses at what
was meant: the mean of the second around each frame, and the steering SHIFT seconds later. A network's weights are
those of its best epoch, which is chosen by the recorded steering of these blocks.
"""

from __future__ import annotations

import argparse
import math
import statistics
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from dataset import IndexConfig, Samples, build_index
from model import TrainConfig, train
from model.evaluation.evaluate import evaluate
from model.metrics import Errors, constant_errors, errors

RECORDED: Final = "recorded"
AROUND_S: Final = 1.0  # 0.5 s before and after

Frame = tuple[str, int, int]
"""Session, row, and log time in ns."""
Steering = Mapping[Frame, float]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--smooth", type=float, default=0.5, help="seconds")
    parser.add_argument("--shift", type=float, default=0.2, help="seconds")
    parser.add_argument("--epochs", type=int, default=10)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    arguments = parser.parse_args()
    smooth, shift = f"smoothed over {arguments.smooth:g} s", f"{arguments.shift:g} s later"
    around = f"smoothed over {AROUND_S:g} s"
    configs = {
        RECORDED: IndexConfig(),
        smooth: IndexConfig(label_smooth_s=arguments.smooth),
        shift: IndexConfig(label_shift_s=arguments.shift),
        f"{smooth}, {shift}": IndexConfig(label_smooth_s=arguments.smooth, label_shift_s=arguments.shift),
    }
    with tempfile.TemporaryDirectory() as name:
        indexes = {
            learnt: build_index(arguments.logs, Path(name, f"index {number}"), config).path
            for number, (learnt, config) in enumerate(configs.items())
        }
        wide = build_index(arguments.logs, Path(name, "index wide"), IndexConfig(label_smooth_s=AROUND_S)).path
        driven = {RECORDED: held_out(indexes[RECORDED]), around: held_out(wide), shift: held_out(indexes[shift])}
        predicted: dict[str, list[Steering]] = {}
        for seed in arguments.seeds:
            for learnt, index in indexes.items():
                run = Path(name) / f"{learnt}, seed {seed}"
                print(f"learns steering {run.name}", file=sys.stderr)
                train(index, run, TrainConfig(epochs=arguments.epochs, seed=seed), figures=False)
                frames = evaluate(run, indexes[RECORDED]).frames
                predicted.setdefault(learnt, []).append(steering_of(frames, "predicted"))
    print_table(driven, predicted)


def held_out(index: Path) -> Steering:
    """The labels of the held-out frames of the centre camera."""
    with Samples(index) as samples:
        table = samples.of_split("validation")
    is_plain = pc.and_(pc.equal(table["camera"], "center"), pc.invert(table["flip"]))
    return steering_of(table.filter(is_plain), "label")


def steering_of(table: pa.Table, column: str) -> Steering:
    names = ("session", "row", "log_time_ns", column)
    rows = zip(*(table[name].to_pylist() for name in names), strict=True)
    return {(session, row, time_ns): steering for session, row, time_ns, steering in rows}


def print_table(driven: Mapping[str, Steering], predicted: Mapping[str, Sequence[Steering]]) -> None:
    """Errors in degrees, the median of the seeds and their range; by session and by what is the truth."""
    print(
        "| session | measured against | frames | learnt | RMSE, deg | MAE, deg | turning MAE, deg | correlation |"
    )
    print("|" + "---|" * 8)
    for session in sorted({frame[0] for frame in driven[RECORDED]}):
        for truth, steering in driven.items():
            frames = [
                frame
                for frame in steering
                if frame[0] == session and all(frame in of for seeds in predicted.values() for of in seeds)
            ]
            expected = values_of(steering, frames)
            mean = float(expected.mean()) if len(expected) else 0.0
            found = {
                "always zero": [constant_errors(0.0, expected)],
                "always the mean": [constant_errors(mean, expected)],
                **{
                    learnt: [errors(values_of(of, frames), expected) for of in seeds]
                    for learnt, seeds in predicted.items()
                },
            }
            for learnt, measured in found.items():
                print(f"| {session} | {truth} | {len(frames):,} | {learnt} | {' | '.join(cells(measured))} |")


def values_of(steering: Steering, frames: Sequence[Frame]) -> NDArray[np.float64]:
    return np.array([steering[frame] for frame in frames], np.float64)


def cells(measured: Sequence[Errors]) -> list[str]:
    names = ("rmse_deg", "mae_deg", "turning_mae_deg", "correlation")
    columns = [[float(getattr(of_seed, name)) for of_seed in measured] for name in names]
    return [
        "" if math.isnan(values[0]) else f"{statistics.median(values):.2f}{range_of(values)}" for values in columns
    ]


def range_of(values: Sequence[float]) -> str:
    return f" ({min(values):.2f} to {max(values):.2f})" if values[1:] else ""


if __name__ == "__main__":
    main()
