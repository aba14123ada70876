"""How far two people agree on the same road: each one's steering beside the other's at the same place.

python benchmarks/same_place.py sessions/lake.mcap sessions/other_lake.mcap

For each row of one recording, the place is found in the other by what the upper part of the picture shows there
and some metres before and behind; beside the row's steering as it was recorded stands the other person's there, as
the mean over a second. What correlates so little between people cannot be foretold from the road alone: a network
that is measured on somebody whom it has never seen knows no more than that, but for where in the lane the car is.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import MPS_PER_MPH
from dataset import IndexConfig, Loader, Samples, build_index

FAR_ROWS: Final = 57  # of the crop's 128: hills and trees, and the road far ahead
AROUND_M: Final = tuple(range(-12, 13, 3))
MEAN_S: Final = 1.0


class Drive(NamedTuple):
    """A recording; arrays of one length (N,)."""

    steering: NDArray[np.float64]
    time_s: NDArray[np.float64]
    way_m: NDArray[np.float64]  # since the start
    look: NDArray[np.float32]  # (N, P): what the picture shows far ahead, of mean 0 and length 1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, nargs=2)
    arguments = parser.parse_args()
    drives = {log.stem: drive_of(log) for log in arguments.logs}
    (name, one), (other_name, other) = drives.items()
    likeness = likeness_of(one, other)
    print("| steering of | beside that of | rows | correlation | RMSE at best, of always the mean |")
    print("|" + "---|" * 5)
    pairs = (
        (name, one, other_name, other, likeness.argmax(1), likeness.max(1)),
        (other_name, other, name, one, likeness.argmax(0), likeness.max(0)),
    )
    for driver, drive, guide, guiding, place, found in pairs:
        expected = smoothed(guiding)[place]
        for rows, heading in ((found > -1, "all"), (found >= np.median(found), "the half that is matched best")):
            r = float(np.corrcoef(drive.steering[rows], expected[rows])[0, 1])
            print(f"| {driver} | {guide} | {heading} | {r:.2f} | {math.sqrt(1 - r * r):.2f} |")


def drive_of(log: Path) -> Drive:
    config = IndexConfig(
        labels="as-recorded", balance=False, flip=False, cameras=("center",), validation_share=0.0
    )
    with tempfile.TemporaryDirectory() as folder:
        built = build_index([log], Path(folder), config)
        with Samples(built.path) as samples, samples.logs[log.stem] as source:
            frames = samples.driving_view("train")
            look = np.zeros((len(frames), 8 * 64), np.float32)
            for numbers, crops in Loader(samples, frames, batch=64).crops(np.arange(len(frames))):
                look[numbers] = [far_of(crop) for crop in crops]
            states = source.vehicle()
    row = frames["row"].to_numpy()
    time_s = frames["log_time_ns"].to_numpy() / 1e9
    speed_mps = np.asarray(states["speed_mph"])[row] * MPS_PER_MPH
    step_m = np.clip(np.diff(time_s), 0, 0.5) * speed_mps[1:]
    return Drive(frames["recorded"].to_numpy(), time_s, np.concatenate([[0], np.cumsum(step_m)]), look)


def far_of(crop: NDArray[np.uint8]) -> NDArray[np.float32]:
    gray = cv2.cvtColor(crop[:FAR_ROWS], cv2.COLOR_BGR2GRAY)
    small: NDArray[np.float32] = cv2.resize(gray, (64, 8), interpolation=cv2.INTER_AREA).astype(np.float32).ravel()
    small -= small.mean()
    return (small / (np.linalg.norm(small) + 1e-6)).astype(np.float32)


def likeness_of(one: Drive, other: Drive) -> NDArray[np.float32]:
    """(N, M): how alike the pictures of two drives are, here and some metres before and behind; -1..1."""
    alike = one.look @ other.look.T
    total = np.zeros_like(alike)
    for away_m in AROUND_M:
        rows = [
            np.clip(np.searchsorted(drive.way_m, drive.way_m + away_m), 0, len(drive.way_m) - 1)
            for drive in (one, other)
        ]
        total += alike[np.ix_(*rows)]
    return (total / len(AROUND_M)).astype(np.float32)


def smoothed(drive: Drive) -> NDArray[np.float64]:
    near = np.abs(drive.time_s[:, None] - drive.time_s[None, :]) <= MEAN_S / 2
    mean: NDArray[np.float64] = (near @ drive.steering) / near.sum(1)
    return mean


if __name__ == "__main__":
    main()
