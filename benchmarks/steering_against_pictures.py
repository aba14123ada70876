"""Does `recorder.log.steering_against_pictures` find labels that are wrong, and nothing else?

python benchmarks/steering_against_pictures.py sessions/lake.mcap sessions/mine.mcap

Of each log: how much it finds in the log as it is; and the steering of ten seconds is mirrored, at twelve places
one after the other, and how much of these rows it finds is told for each. A straight has nothing to be found.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common.stretches import stretches
from recorder import Log
from recorder.log.row_quality import elapsed_s
from recorder.log.steering_against_pictures import against_pictures

PLACES: Final = 12
MIRRORED_S: Final = 10.0


class Mirrored(Log):
    """A log of which the steering of some rows has the other sign."""

    rows: NDArray[np.bool_] | None = None

    def vehicle(self) -> pa.Table:
        vehicle = super().vehicle()
        if self.rows is None:
            return vehicle
        steering = vehicle["steering"].to_numpy()
        other = np.where(self.rows, -steering, steering)
        return vehicle.set_column(vehicle.column_names.index("steering"), "steering", pa.array(other))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, nargs="+")
    print("| session | rows | CPU, s | rows found as it is | percent of the mirrored rows found, by place |")
    print("|---|---|---|---|---|")
    for path in parser.parse_args().logs:
        with Mirrored(path) as log:
            time_s = elapsed_s(log.vehicle()["log_time_ns"].to_numpy())
            start_s = time.process_time()
            as_it_is = against_pictures(log)
            cpu_s = time.process_time() - start_s
            found, beside = [], 0
            for begin_s in np.linspace(5, time_s[-1] - 5 - MIRRORED_S, PLACES):
                log.rows = (time_s >= begin_s) & (time_s < begin_s + MIRRORED_S)
                mask = against_pictures(log)
                found.append(round(100 * mask[log.rows].mean()))
                beside = max([beside, *(last - first + 1 for first, last in stretches(mask & ~log.rows))])
        told = " ".join(map(str, found))
        print(f"| {path.stem} | {len(time_s)} | {cpu_s:.2f} | {as_it_is.sum()} | {told} (beside: {beside} rows) |")


if __name__ == "__main__":
    main()
