"""The steering of a session, ten seconds at a time, with pandas.

python examples/steering_over_time.py sessions/lake.mcap
"""

import sys

import pandas as pd

from recorder import Log
from recorder.log.session_car import max_steering_deg_of


def steering_over_time(path: str, every: str = "10s") -> pd.DataFrame:
    """A row for each part of the session; none of its pictures is read."""
    with Log(path) as log:
        rows = log.vehicle().to_pandas()
        rows["degrees"] = rows.steering * max_steering_deg_of(log)  # steering is -1 (left) .. 1 (right)
    rows["turned"] = rows.degrees.diff().abs()
    rows.index = pd.to_timedelta(rows.log_time_ns - rows.log_time_ns.iloc[0], unit="ns")
    parts = rows.groupby(rows.index.floor(every))  # pauses, of days perhaps, have no parts
    table = pd.DataFrame(
        {
            "rows": parts.row.count(),
            "mean_deg": parts.degrees.mean(),
            "leftmost_deg": parts.degrees.min(),
            "rightmost_deg": parts.degrees.max(),
            "turned_deg": parts.turned.sum(),  # how far the wheels were turned, to and fro
            "speed_mph": parts.speed_mph.mean(),
        }
    )
    return table.set_axis(table.index.total_seconds().rename("second"))


if __name__ == "__main__":
    print(steering_over_time(sys.argv[1]).round(1).to_string())
