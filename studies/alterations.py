"""Do random alterations in every epoch help? Networks are trained on some people and measured on the others.

python studies/alterations.py FOLDER sessions/*.mcap [--network small] [--recipes people altered] [--seeds 0 1 2]
    [--parts three drive] [--last]

Recipes: "people"; "altered"; "large-steps", the default; "as seen" is "altered" with --light as-seen; "NAME
alone" and "all but NAME" have one alteration, and all others; "neither" is "all but mix" with --light as-seen.

"three": for each person, a network trained on all others is measured on this person. Frames of crashes are left
out. Errors are divided by those of always predicting the mean of the same frames. "drive": a network trained on
half a lap of both built-in tracks by the simulated keyboard driver drives full laps. Each result is a file in
FOLDER/results. Existing results are not computed again, and a stopped training continues.
--last measures the last epoch, also with "people", which keeps the one with the smallest driving error on the
held-out frames.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Final

from kept_result import keep
from printed_table import print_head, print_row
from toolkit_command import output_of

from dataset import IndexConfig, build_index
from dataset.config import EARLIER_ALTERATIONS, EPOCH_ALTERATIONS
from drive.config import DriveConfig
from drive.evaluation.closed_loop import BuiltInSimulator
from drive.evaluation.closed_loop import evaluate as drive
from model import TrainConfig, load_pilot, train
from model.evaluation.evaluate import evaluate_sessions
from model.training.trainer import Trained

ALTERED: Final = TrainConfig.of("altered")
RECIPES: Final[Mapping[str, TrainConfig]] = {
    "people": TrainConfig.of("people"),
    "altered": ALTERED,
    "large-steps": TrainConfig(),
    "as seen": replace(ALTERED, light="as-seen"),
    "neither": replace(ALTERED, light="as-seen", alter_each_epoch=EARLIER_ALTERATIONS),
    **{f"{name} alone": replace(ALTERED, alter_each_epoch=(name,)) for name in EPOCH_ALTERATIONS},
    **{
        f"all but {name}": replace(
            ALTERED, alter_each_epoch=tuple(other for other in EPOCH_ALTERATIONS if other != name)
        )
        for name in EPOCH_ALTERATIONS
    },
}
MEASURES: Final = "RMSE", "error on turns", "correlation"
ROADS: Final = "lake", "mountain", "random:1", "random:2", "random:3"
MPH: Final = 15.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--network", default=TrainConfig.network)
    parser.add_argument("--recipes", nargs="+", default=["people", "altered"], choices=RECIPES)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--parts", nargs="+", default=["three"], choices=["three", "drive"])
    parser.add_argument("--last", action="store_true")
    chosen = parser.parse_args()
    logs = [log.resolve() for log in chosen.logs]
    chosen.folder.mkdir(parents=True, exist_ok=True)
    for seed, recipe in product(chosen.seeds, chosen.recipes):
        if "three" in chosen.parts:
            for learnt, person in parts(logs):
                measure(chosen.folder, chosen.network, recipe, seed, learnt, person, chosen.last)
        if "drive" in chosen.parts:
            drive_roads(chosen.folder, chosen.network, recipe, seed, chosen.last)
    if "three" in chosen.parts:
        print_people(chosen.folder, chosen.network, logs, chosen.recipes, chosen.seeds, chosen.last)
    if "drive" in chosen.parts:
        print_drives(chosen.folder, chosen.network, chosen.recipes, chosen.seeds, chosen.last)


def parts(logs: Sequence[Path]) -> list[tuple[list[Path], Path]]:
    """For each person, the logs of all others and the person's own."""
    return [([other for other in logs if other != log], log) for log in logs]


def measure(
    folder: Path, network: str, recipe: str, seed: int, learnt: Sequence[Path], person: Path, last: bool
) -> None:
    """Train on `learnt`, and measure on `person`."""
    result = file_of(folder, network, recipe, seed, learnt, last)
    if result.exists():
        return
    print(result.stem, file=sys.stderr, flush=True)
    trained = trained_on(folder, network, recipe, seed, learnt)
    evaluation = evaluate_sessions(measured(trained.run, last), [person])
    sessions = {
        session: {
            "RMSE": measures.network.rmse_deg / measures.mean.rmse_deg,
            "error on turns": measures.network.turning_mae_deg / measures.mean.turning_mae_deg,
            "correlation": measures.network.correlation,
        }
        for session, measures in evaluation.driving.sessions.items()
    }
    keep(result, {"best_epoch": trained.best_epoch, "sessions": sessions})


def trained_on(folder: Path, network: str, recipe: str, seed: int, learnt: Sequence[Path]) -> Trained:
    # the held-out frames are not needed to choose an epoch, but an index must hold out some
    index = folder / "indexes" / "-".join(log.stem for log in learnt)
    if not index.exists():
        build_index(list(learnt), index, IndexConfig(validation_share=0.1))
    run = folder / "runs" / file_of(folder, network, recipe, seed, learnt, last=False).stem
    config = replace(RECIPES[recipe], network=network, seed=seed, threads=1)
    return train(index, run, config, resume=run.exists(), show_progress=False)


def measured(run: Path, last: bool) -> Path:
    return run / "last" if last else run


def drive_roads(folder: Path, network: str, recipe: str, seed: int, last: bool) -> None:
    """Train on half laps by the simulated keyboard driver, and drive."""
    sessions = [folder / "sessions" / f"keyboard_{track}.mcap" for track in ("lake", "mountain")]
    result = file_of(folder, network, recipe, seed, sessions, last)
    if result.exists():
        return
    print(result.stem, file=sys.stderr, flush=True)
    for session, track in zip(sessions, ("lake", "mountain"), strict=True):
        if not session.exists():
            words = ("--driver", "keyboard", "--track", track, "--laps", 0.5, "--speed", f"{MPH:g}", "--seed", 1)
            output_of(folder, "bc-record", session.stem, *words)
    trained = trained_on(folder, network, recipe, seed, sessions)
    drives = [(BuiltInSimulator(road), DriveConfig(set_speed_mph=MPH)) for road in ROADS]
    pilot = load_pilot(measured(trained.run, last))
    reports = [
        result.report
        for result in drive(pilot, drives, trained.run / ("drives-last" if last else "drives"), overwrite=True)
    ]
    keep(result, dict(zip(ROADS, reports, strict=True)))


def print_drives(folder: Path, network: str, recipes: Sequence[str], seeds: Sequence[int], last: bool) -> None:
    """Print interventions, and the mean offset as a share of the half width, for each recipe and seed."""
    print()
    print_head(f"`{network}`", "seed", *ROADS)
    sessions = [Path("keyboard_lake"), Path("keyboard_mountain")]
    for recipe, seed in product(recipes, seeds):
        file = file_of(folder, network, recipe, seed, sessions, last)
        if file.exists():
            reports = json.loads(file.read_text())
            cells = [f"{reports[road]['interventions']}, {reports[road]['mean_offset']:.3f}" for road in ROADS]
            print_row(recipe, seed, *cells)


def file_of(folder: Path, network: str, recipe: str, seed: int, learnt: Sequence[Path], last: bool) -> Path:
    named = "-".join([network, recipe.replace(" ", "-"), *(log.stem for log in learnt)])
    return folder / ("results-last" if last else "results") / f"{named}-{seed}.json"


def print_people(
    folder: Path, network: str, logs: Sequence[Path], recipes: Sequence[str], seeds: Sequence[int], last: bool
) -> None:
    """Print, for each recipe, the mean over the people of each seed: its mean, minimum and maximum over seeds."""
    print()
    print_head(f"`{network}`", "seeds", *MEASURES)
    for recipe in recipes:
        seed_means: list[list[float]] = []
        for seed in seeds:
            files = [file_of(folder, network, recipe, seed, learnt, last) for learnt, _ in parts(logs)]
            if not all(file.exists() for file in files):
                continue
            measures = [values for file in files for values in json.loads(file.read_text())["sessions"].values()]
            seed_means.append([statistics.fmean(values[name] for values in measures) for name in MEASURES])
        if not seed_means:
            continue
        columns = list(zip(*seed_means, strict=True))
        cells = [f"{statistics.fmean(means):.3f} ({min(means):.3f} to {max(means):.3f})" for means in columns]
        print_row(recipe, len(seed_means), *cells)


if __name__ == "__main__":
    main()
