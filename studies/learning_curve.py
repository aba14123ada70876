"""How many pictures does a network need? Closed-loop autonomy and offline error for growing numbers of pictures.

python studies/learning_curve.py FOLDER [--figure curve.png]

Records a lap of both built-in tracks in FOLDER, trains on the beginning of both, and lets every network drive a
full lap of both. All networks are measured offline on the same frames: the end of both laps, which no network has
seen. Existing results in FOLDER are not computed again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from figure_style import BLUE, ORANGE, figure_style, new_figure
from kept_result import keep
from printed_table import print_head, print_row
from toolkit_command import output_of

TRACKS: Final = ("lake", "mountain")
PICTURES: Final = (1000, 2000, 4000, 8000)
CAMERAS: Final = 3
UNSEEN: Final = 0.7  # share of the lap after which no network is trained


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    folder: Path = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    rows = {track: record(folder, track) for track in TRACKS}
    for track in TRACKS:
        trim(folder, track, "unseen", round(UNSEEN * rows[track]), rows[track] - 1)
    points = [measured(folder, rows, count) for count in PICTURES]
    print_table(points)
    if arguments.figure is not None:
        draw(points, arguments.figure)


def measured(folder: Path, rows: dict[str, int], pictures: int) -> dict[str, Any]:
    """Train on about `pictures` pictures, drive and measure. Returns the results."""
    name = str(pictures)
    kept = folder / "results" / f"{name}.json"
    if kept.exists():
        return dict(json.loads(kept.read_text()))
    track_rows = round(pictures / CAMERAS / len(TRACKS))
    for track in TRACKS:
        trim(folder, track, name, 0, track_rows - 1)
    if not (folder / "runs" / name / "model.safetensors").exists():
        index, recipe = ("--index", f"index-{name}"), ("--recipe", "original")
        output_of(folder, "bc-index", *(f"{track}-{name}" for track in TRACKS), *index, *recipe)
        output_of(folder, "bc-train", *index, *recipe, "--name", name, "--epochs", 10)
    unseen = [f"{track}-unseen" for track in TRACKS]
    [offline] = parsed(output_of(folder, "bc-eval", name, "--session", *unseen, "--json"))
    point = {
        "pictures": CAMERAS * track_rows * len(TRACKS),
        "shares": [track_rows / rows[track] for track in TRACKS],
        "driven": parsed(output_of(folder, "bc-eval", "drive", name, "--tracks", *TRACKS, "--json", "--force")),
        "offline": {name: offline[name] for name in ("network", "mean", "balanced_rmse_deg") if name in offline},
    }
    keep(kept, point)
    return point


def print_table(points: Sequence[dict[str, Any]]) -> None:
    driven = [f"{track}: {what}" for track in TRACKS for what in ("interventions", "autonomy", "largest distance")]
    print_head("pictures", "of a lap", *driven, "RMSE", "MAE on turns", "correlation")
    for point in points:
        network = point["offline"]["network"]
        cells = [f"{point['pictures']:,}", " and ".join(f"{share:.0%}" for share in point["shares"])]
        for drive in point["driven"]:
            cells += [str(drive["interventions"]), f"{drive['autonomy_percent']:.1f} %"]
            cells.append(f"{drive['max_offset']:.2f}")
        cells += [f"{network[name]:.2f}" for name in ("rmse_deg", "turning_mae_deg", "correlation")]
        print_row(*cells)
    print(f"\nAlways the mean: RMSE {points[0]['offline']['mean']['rmse_deg']:.2f} deg.")


def draw(points: Sequence[dict[str, Any]], path: Path) -> None:
    with figure_style():
        figure = new_figure(2.6)
        autonomy, error = figure.subplots(1, 2)
        pictures = [point["pictures"] for point in points]
        for number, (track, color) in enumerate(zip(TRACKS, (BLUE, ORANGE), strict=True)):
            values = [point["driven"][number]["autonomy_percent"] for point in points]
            autonomy.plot(pictures, values, marker="o", color=color, label=track)
        autonomy.set(ylabel="autonomy of a full lap [%]", ylim=(0, 105))
        autonomy.legend()
        error.plot(pictures, [point["offline"]["network"]["rmse_deg"] for point in points], marker="o", color=BLUE)
        error.axhline(
            points[0]["offline"]["mean"]["rmse_deg"], color="0.5", linestyle="--", label="always the mean"
        )
        error.set(ylabel="RMSE on unseen road [deg]", ylim=(0, None))
        error.legend()
        for axes in (autonomy, error):
            axes.set_xscale("log", base=2)
            axes.set_xticks(pictures, [f"{count:,}" for count in pictures])
            axes.minorticks_off()
            axes.set_xlabel("pictures trained on")
        figure.savefig(path, dpi=200)


def record(folder: Path, track: str) -> int:
    """Record a lap, if it does not exist. Returns its number of rows."""
    log = folder / "laps" / f"{track}.mcap"
    if not log.exists():
        output_of(folder, "bc-record", track, "--track", track, "--laps", 1, "--sessions", "laps")
    [info] = parsed(output_of(folder, "bc-log", "info", f"laps/{track}.mcap", "--json"))
    return next(int(topic["messages"]) for topic in info["topics"] if topic["topic"] == "/vehicle")


def trim(folder: Path, track: str, name: str, first: int, last: int) -> None:
    part = f"sessions/{track}-{name}.mcap"
    if not (folder / part).exists():
        (folder / "sessions").mkdir(exist_ok=True)
        output_of(folder, "bc-log", "trim", f"laps/{track}.mcap", "--rows", first, last, "--to", part)


def parsed(output: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in output.splitlines()]


if __name__ == "__main__":
    main()
