"""How many pictures does a network need? Closed-loop autonomy and offline error for growing numbers of pictures.

python studies/learning_curve.py FOLDER [--pictures 1000 2000 4000 8000] [--epochs 10] [--seed 0]
    [--figure curve.png]

Records a lap of both built-in tracks in FOLDER, trains on the beginning of both, and lets every network drive a
full lap of both. All networks are measured offline on the same frames: the end of both laps, which no network has
seen. Existing results in FOLDER are not computed again.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from figure_style import BLUE, ORANGE, figure_style, new_figure

TRACKS: Final = ("lake", "mountain")
CAMERAS: Final = 3
UNSEEN: Final = 0.7  # share of the lap after which no network is trained


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--pictures", type=int, nargs="+", default=[1000, 2000, 4000, 8000])
    parser.add_argument("--epochs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    folder: Path = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    rows = {track: record(folder, track) for track in TRACKS}
    for track in TRACKS:
        trim(folder, track, "unseen", round(UNSEEN * rows[track]), rows[track] - 1)
    points = [measured(folder, rows, count, arguments.epochs, arguments.seed) for count in arguments.pictures]
    print_table(points)
    if arguments.figure is not None:
        draw(points, arguments.figure)


def measured(folder: Path, rows: dict[str, int], pictures: int, epochs: int, seed: int) -> dict[str, Any]:
    """Train on about `pictures` pictures, drive and measure. Returns the results."""
    name = f"{pictures}-{epochs}-{seed}"
    kept = folder / "results" / f"{name}.json"
    if kept.exists():
        return dict(json.loads(kept.read_text()))
    track_rows = round(pictures / CAMERAS / len(TRACKS))
    for track in TRACKS:
        if track_rows > UNSEEN * rows[track]:
            sys.exit(f"{pictures} pictures are more than {UNSEEN:.0%} of a lap of {track}")
        trim(folder, track, str(pictures), 0, track_rows - 1)
    if not (folder / "runs" / name / "model.safetensors").exists():
        index, recipe = ("--index", f"index-{pictures}"), ("--recipe", "original")
        bc(folder, "index", *(f"{track}-{pictures}" for track in TRACKS), *index, *recipe)
        bc(folder, "train", *index, *recipe, "--name", name, "--epochs", epochs, "--seed", seed)
    [offline] = parsed(bc(folder, "eval", name, "--session", *(f"{track}-unseen" for track in TRACKS), "--json"))
    point = {
        "pictures": CAMERAS * track_rows * len(TRACKS),
        "shares": [track_rows / rows[track] for track in TRACKS],
        "driven": parsed(bc(folder, "eval", name, "--simulator", *TRACKS, "--json", "--force")),
        "offline": {name: offline[name] for name in ("network", "mean", "balanced_rmse_deg") if name in offline},
    }
    kept.parent.mkdir(exist_ok=True)
    kept.write_text(json.dumps(point))
    return point


def print_table(points: Sequence[dict[str, Any]]) -> None:
    of_tracks = " | ".join(f"{track}: interventions | autonomy | largest distance" for track in TRACKS)
    print(f"| pictures | of a lap | {of_tracks} | RMSE | MAE on turns | correlation |")
    print("|" + "---|" * (5 + 3 * len(TRACKS)))
    for point in points:
        network = point["offline"]["network"]
        cells = [f"{point['pictures']:,}", " and ".join(f"{share:.0%}" for share in point["shares"])]
        for drive in point["driven"]:
            cells += [str(drive["interventions"]), f"{drive['autonomy_percent']:.1f} %"]
            cells.append(f"{drive['max_offset']:.2f}")
        cells += [f"{network[name]:.2f}" for name in ("rmse_deg", "turning_mae_deg", "correlation")]
        print(f"| {' | '.join(cells)} |")
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
        bc(folder, "record", track, "--track", track, "--laps", 1, "--sessions", "laps")
    [info] = parsed(bc(folder, "log", "info", f"laps/{track}.mcap", "--json"))
    return next(int(topic["messages"]) for topic in info["topics"] if topic["topic"] == "/vehicle")


def trim(folder: Path, track: str, name: str, first: int, last: int) -> None:
    part = f"sessions/{track}-{name}.mcap"
    if not (folder / part).exists():
        (folder / "sessions").mkdir(exist_ok=True)
        bc(folder, "log", "trim", f"laps/{track}.mcap", "--rows", first, last, "--to", part)


def parsed(output: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in output.splitlines()]


MODULES: Final = {
    "record": "recorder.cli",
    "log": "recorder.log_cli",
    "index": "dataset.cli",
    "train": "model.cli",
    "eval": "drive.evaluation.eval_cli",
}


def bc(folder: Path, name: str, *arguments: object) -> str:
    """Run a `bc-` command in the folder. Returns its output."""
    code = f"from {MODULES[name]} import main; main()"
    words = [str(argument) for argument in arguments]
    print(f"bc-{name} {' '.join(words)}", file=sys.stderr, flush=True)
    program = [sys.executable, "-c", code, *words]
    done = subprocess.run(program, cwd=folder, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode not in (0, 3):
        sys.exit(done.returncode)
    return done.stdout


if __name__ == "__main__":
    main()
