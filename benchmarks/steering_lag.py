"""Is the lag that is measured in pictures the true one? And can pictures tell how long a person takes to react?

python benchmarks/steering_lag.py sessions/lake.mcap sessions/mine.mcap

Takes the steering of each log later and earlier by known times, and measures the lag again: it should have changed
by as much. Beside it stands what was tried for people's reactions, and does not tell them: a ridge regression from
tiny pictures to the steering some time later (its mean over 0.5 s), tried on blocks of time that it has not seen,
and the time at which it tells the steering best. Of the built-in expert, who reacts at once, that should be 0.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from dataset import decode
from recorder import Log
from recorder.log.row_quality import States, elapsed_s
from recorder.log.steering_habits import SteeringLag
from recorder.log.steering_lag import measure_lag
from recorder.log.topics import camera_topic

LATER_S: Final = (-0.3, -0.2, 0.1, 0.2, 0.3, 0.5)
TRIED_S: Final = np.arange(-10, 21) * 0.05
BLOCK_S: Final = 8.0
FOLDS: Final = 5
NEAR_S: Final = 1.5  # training keeps so far from what is predicted
TINY: Final = (40, 16)
PENALTY: Final = 0.3  # of the mean variance of a pixel

Floats = NDArray[np.float64]


class Delayed(Log):
    """A log whose steering came so much later."""

    later_s = 0.0

    def vehicle(self) -> pa.Table:
        vehicle = super().vehicle()
        time_s = elapsed_s(vehicle["log_time_ns"].to_numpy())
        steering = np.interp(time_s - self.later_s, time_s, vehicle["steering"].to_numpy())
        return vehicle.set_column(vehicle.column_names.index("steering"), "steering", pa.array(steering))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, nargs="+")
    columns = " | ".join(f"{later_s:+g} s later" for later_s in LATER_S)
    print(f"| session | lag, s | correlation | CPU, s | {columns} | ridge: best at, s | its correlation, at 0 |")
    print("|" + "---|" * (6 + len(LATER_S)))
    for path in parser.parse_args().logs:
        with Delayed(path) as log:
            log.pictures(camera_topic("center"))  # its index is read
            start_s = time.process_time()
            lag = measure_lag(log)
            cpu_s = time.process_time() - start_s
            changes = [change(lag, measured(log, later_s)) for later_s in LATER_S]
            log.later_s = 0.0
            correlations = ridge(log)
        best = int(np.argmax(correlations))
        told = f"{lag.lag_s:+.2f} ±{lag.margin_s:.2f} | {lag.correlation:.2f}" if lag else "- | -"
        found = f"{TRIED_S[best]:+.2f} | {correlations[best]:.2f}, {correlations[TRIED_S.tolist().index(0.0)]:.2f}"
        print(f"| {path.stem} | {told} | {cpu_s:.2f} | {' | '.join(changes)} | {found} |")


def measured(log: Delayed, later_s: float) -> SteeringLag | None:
    log.later_s = later_s
    return measure_lag(log)


def change(before: SteeringLag | None, after: SteeringLag | None) -> str:
    return "-" if before is None or after is None else f"{after.lag_s - before.lag_s:+.2f}"


def ridge(log: Log) -> Floats:
    """For each of TRIED_S the correlation of the steering so much later with what tiny pictures foretell of it."""
    states = States.of(log.vehicle())
    time_s = elapsed_s(states.time_ns)
    pixels = np.stack([tiny(log.picture(row)) for row in states.row.tolist()])
    smooth = np.array([states.steering[np.abs(time_s - at_s) <= 0.25].mean() for at_s in time_s])
    later = np.stack([np.interp(time_s + tried_s, time_s, smooth) for tried_s in TRIED_S], axis=1)
    same_drive = [np.abs(np.interp(time_s + s, time_s, time_s) - time_s - s) < 1e-6 for s in (-0.6, 1.1)]
    usable = same_drive[0] & same_drive[1] & (states.speed_mph >= 8)
    fold = (time_s // BLOCK_S).astype(int) % FOLDS
    foretold = np.full(later.shape, np.nan)
    for number in range(FOLDS):
        test = usable & (fold == number)
        at_s = time_s[test]
        nearest = np.abs(at_s[np.clip(np.searchsorted(at_s, time_s), 0, len(at_s) - 1)] - time_s)
        before = np.abs(at_s[np.clip(np.searchsorted(at_s, time_s) - 1, 0, len(at_s) - 1)] - time_s)
        train = usable & ~test & (np.minimum(nearest, before) > NEAR_S)
        mean, spread = pixels[train].mean(axis=0), pixels[train].std(axis=0) + 0.05
        seen = (pixels[train] - mean) / spread
        variance = seen.T @ seen / len(seen)
        variance += PENALTY * np.trace(variance) / len(variance) * np.eye(len(variance))
        middle = later[train].mean(axis=0)
        weights = np.linalg.solve(variance, seen.T @ (later[train] - middle) / len(seen))
        foretold[test] = (pixels[test] - mean) / spread @ weights + middle
    both = zip(foretold[usable].T, later[usable].T, strict=True)
    return np.array([np.corrcoef(told, true)[0, 1] for told, true in both])


def tiny(picture: bytes) -> Floats:
    """The road of a picture, in few pixels of the same mean and contrast."""
    shown = decode(picture)
    height = len(shown)
    road = cv2.cvtColor(shown[height * 5 // 16 : height * 7 // 8], cv2.COLOR_BGR2GRAY)
    pixels = cv2.resize(road, TINY, interpolation=cv2.INTER_AREA).astype(np.float64).ravel()
    return np.asarray((pixels - pixels.mean()) / (pixels.std() + 1))


if __name__ == "__main__":
    main()
