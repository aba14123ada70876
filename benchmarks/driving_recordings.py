"""Whether driving recordings (bc-eval --on) puts networks in the order in which they truly drive.

python benchmarks/driving_recordings.py runs --on sessions/lake.mcap sessions/mountain.mcap
    --tracks lake mountain [--laps 1] [--speed 15] [--departure 0.5 1 1.5] [--table results.jsonl]

Every run in the folder drives the recordings, and the built-in simulator's tracks. A line of JSON a run is added
to the table as soon as it is measured, so that a stopped benchmark goes on where it was; then come the rank
correlations (Spearman) of each measure on recordings with each measure of true driving, over all runs.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive.config import DriveConfig
from drive.evaluation.closed_loop import evaluate
from drive.evaluation.simulator_process import BuiltInSimulator
from model import Pilot, load_pilot
from model.evaluation.recorded_drive import RecordedDrive, drive_recording


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path)
    parser.add_argument("--on", type=Path, nargs="+", required=True, help="logs")
    parser.add_argument("--tracks", nargs="+", default=["lake", "mountain"])
    parser.add_argument("--laps", type=float, default=1.0)
    parser.add_argument("--speed", type=float, default=15.0, help="mph, on the tracks")
    parser.add_argument("--departure", type=float, nargs="+", default=[1.0], help="metres")
    parser.add_argument("--table", type=Path, default=Path("driving_recordings.jsonl"))
    arguments = parser.parse_args()
    table = arguments.table
    lines = [json.loads(line) for line in table.read_text().splitlines()] if table.exists() else []
    measured = {line["run"] for line in lines}
    for run in sorted(folder for folder in arguments.runs.iterdir() if (folder / "config.json").is_file()):
        if run.name in measured:
            continue
        pilot = load_pilot(run)
        pilot.warm_up()
        line: dict[str, Any] = {"run": run.name}
        for departure_m in arguments.departure:
            drives = [drive_recording(pilot.predict, log, departure_m=departure_m) for log in arguments.on]
            line |= {f"{name}, {departure_m:g} m": value for name, value in of_recordings(drives).items()}
        line |= of_tracks(pilot, arguments.tracks, arguments.laps, arguments.speed)
        lines.append(line)
        with table.open("a") as file:
            file.write(json.dumps(line) + "\n")
        print(line, flush=True)
    report(lines)


def of_recordings(drives: Sequence[RecordedDrive]) -> dict[str, float]:
    """Measures in which less is better, over all the recordings together."""
    km = sum(drive.distance_m for drive in drives) / 1000
    rows = sum(drive.rows for drive in drives)
    return {
        "recorded: interventions a km": sum(drive.interventions for drive in drives) / km,
        "recorded: mean offset": sum(drive.mean_offset_m * drive.rows for drive in drives) / rows,
    }


def of_tracks(pilot: Pilot, tracks: Sequence[str], laps: float, speed_mph: float) -> dict[str, float]:
    """Measures in which less is better, over all tracks together."""
    config = DriveConfig(set_speed_mph=speed_mph)
    with tempfile.TemporaryDirectory() as logs:
        drives = [(BuiltInSimulator(track, laps), config) for track in tracks]
        reports = [result.report for result in evaluate(pilot, drives, Path(logs))]
    km = sum(report["distance_m"] for report in reports) / 1000
    return {
        "true: interventions a km": sum(report["interventions"] for report in reports) / km,
        "true: mean offset": float(np.mean([report["mean_offset"] for report in reports])),
        "true: interventions": sum(report["interventions"] for report in reports),
    }


def report(lines: Sequence[dict[str, Any]]) -> None:
    measures, truths = ([name for name in lines[0] if name.startswith(kind)] for kind in ("recorded", "true"))
    print(f"\nrank correlation over {len(lines)} runs")
    print(f"| | {' | '.join(truths)} |")
    for measure in measures:
        found = [
            spearman(*(np.array([line[name] for line in lines]) for name in (measure, truth))) for truth in truths
        ]
        print(f"| {measure} | {' | '.join(f'{value:.2f}' for value in found)} |")


def spearman(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """The correlation of ranks; equal values share the mean of theirs."""
    return float(np.corrcoef(ranks(first), ranks(second))[0, 1])


def ranks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray([(values < each).sum() + ((values == each).sum() - 1) / 2 for each in values])


if __name__ == "__main__":
    main()
