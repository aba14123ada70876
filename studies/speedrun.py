"""How soon does a network drive? The seconds from a finished index to a network that drives both built-in tracks.

python studies/speedrun.py FOLDER [--seeds 0 1 2 3 4] [--roads 15 20] [-- FLAGS OF bc-train]

The built-in expert records half a lap of each track in FOLDER, and `bc-index` builds the index. The time does not
contain this. Then `bc-train` trains a network for each seed, with two threads. The table shows the seconds of the
whole command, and those in which it learned, decoding included. Every network drives a full lap of both tracks at
10 mph, with --roads also of random:1 to 5. A record needs no intervention on the two tracks with any of five
seeds. The table shows each seed's interventions, and the mean offset from the centre line as a share of the half
width. Results in FOLDER are not computed again. Other work on the machine makes the times longer.

python studies/speedrun.py FOLDER                                    # the default recipe
python studies/speedrun.py FOLDER -- --recipe altered --epochs 4     # an earlier one
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

from kept_result import keep
from printed_table import print_head, print_row
from toolkit_command import output_of

from common.process_settings import usable_cores
from model.runs.history import read_epochs

TRACKS: Final = ("lake", "mountain")
TRACK_MPH: Final = 10
ROADS: Final = tuple(f"random:{seed}" for seed in range(1, 6))
THREADS: Final = 2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--roads", type=int, nargs="+", default=[], metavar="MPH", help="also drive random:1 to 5")
    parser.add_argument("flags", nargs="*", help="of bc-train, after --")
    arguments = parser.parse_args()
    folder: Path = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    for track in TRACKS:
        if not (folder / "sessions" / f"{track}.mcap").exists():
            output_of(folder, "bc-record", track, "--track", track, "--laps", 0.5)
    if not (folder / "index").exists():
        output_of(folder, "bc-index")
    runs = [f"{slug(arguments.flags)}-{seed}" for seed in arguments.seeds]
    trained = [train(folder, run, seed, arguments.flags) for run, seed in zip(runs, arguments.seeds, strict=True)]
    drives = [(run, mph) for mph in (TRACK_MPH, *arguments.roads) for run in runs]
    with ThreadPoolExecutor(usable_cores()) as pool:
        driven = list(pool.map(lambda planned: drive(folder, *planned), drives))
    print_table(arguments.flags, trained, dict(zip(drives, driven, strict=True)))


def slug(flags: Sequence[str]) -> str:
    return "-".join(flag.strip("-").replace("/", "-") for flag in flags) or "default"


def train(folder: Path, run: str, seed: int, flags: Sequence[str]) -> dict[str, Any]:
    """Train with a seed. Returns the seconds, the samples, and the driving error."""
    kept = folder / "results" / f"{run}.json"
    if not kept.exists():
        begun_s = time.monotonic()
        output_of(folder, "bc-train", "--name", run, "--seed", seed, "--threads", THREADS, *flags)
        whole_s = time.monotonic() - begun_s
        epochs = read_epochs(folder / "runs" / run)
        result = {
            "whole_s": whole_s,
            "learning_s": sum(epoch.seconds for epoch in epochs),
            "samples": round(sum(epoch.seconds * epoch.samples_per_s for epoch in epochs)),
            "driving_error": epochs[-1].measures.driving_error,
        }
        keep(kept, result)
    return dict(json.loads(kept.read_text()))


def drive(folder: Path, run: str, mph: int) -> list[dict[str, Any]]:
    """Drive full laps: of both tracks at `TRACK_MPH`, of random roads at other speeds. Returns the reports."""
    kept = folder / "results" / f"{run}-{mph}mph.json"
    if not kept.exists():
        roads = TRACKS if mph == TRACK_MPH else ROADS
        words = ("--tracks", *roads, "--speed", mph, "--drives", f"drives/{run}", "--json", "--force")
        output = output_of(folder, "bc-eval", "drive", run, *words)
        keep(kept, [json.loads(line) for line in output.splitlines()])
    return list(json.loads(kept.read_text()))


def print_table(
    flags: Sequence[str],
    trained: Sequence[dict[str, Any]],
    driven: dict[tuple[str, int], list[dict[str, Any]]],
) -> None:
    """Print a row for these flags: medians of the seconds, the interventions of each seed, means."""
    speeds_mph = list(dict.fromkeys(mph for _, mph in driven))
    columns = [f"{'lake and mountain' if mph == TRACK_MPH else 'random:1 to 5'}, {mph} mph" for mph in speeds_mph]
    print_head("flags", "samples", "learning, s", "whole command, s", "driving error", *columns)
    cells = [" ".join(flags) or "(default)", f"{trained[0]['samples']:,}"]
    for name in ("learning_s", "whole_s"):
        times_s = [result[name] for result in trained]
        cells.append(f"{statistics.median(times_s):.1f} ({min(times_s):.1f} to {max(times_s):.1f})")
    cells.append(f"{statistics.fmean(result['driving_error'] for result in trained):.2f}")
    for mph in speeds_mph:
        seeds = [drives for (_, driven_mph), drives in driven.items() if driven_mph == mph]
        interventions = ", ".join(str(sum(drive["interventions"] for drive in drives)) for drives in seeds)
        offset = statistics.fmean(drive["mean_offset"] for drives in seeds for drive in drives)
        cells.append(f"{interventions}; offset {offset:.3f}")
    print_row(*cells)


if __name__ == "__main__":
    main()
