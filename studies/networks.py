"""The networks of the toolkit side by side: parameters, size, training speed, ms a picture, and how they drive.

python studies/networks.py FOLDER [--networks original small] [--seeds 0] [--what speed train drive]

Existing results in FOLDER are not computed again, so the study can be stopped at any moment. The built-in expert
records half a lap of each track in FOLDER. Times are processor time of one thread, the minimum of several rounds
in which the networks take turns: a busy machine gives the same times as an idle one.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from printed_table import print_head, print_row
from toolkit_command import output_of

from common.files import atomic_file
from dataset import IndexConfig, build_index
from dataset.picture_spec import PictureSpec
from model import Pilot, TrainConfig, train
from model.adam import Adam
from model.config import Precision
from model.device import choose_machine, training_dtype
from model.network.choice import NetworkChoice, choose_network
from model.network.names import BUILT_IN
from model.runs.history import read_history
from model.training.step import training_step

WHAT: Final = ("speed", "train", "drive")
PICTURES: Final = 64  # in a step
PREDICTIONS: Final = 20  # in a round
ROUNDS: Final = 5
RECORDED: Final = ("lake", "mountain")
DRIVEN: Final = (*RECORDED, "random:1", "random:2", "random:3")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--networks", nargs="+", default=list(BUILT_IN), choices=BUILT_IN)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--what", nargs="+", default=list(WHAT), choices=WHAT)
    arguments = parser.parse_args()
    folder: Path = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    if "speed" in arguments.what:
        print_speed(speeds(folder / "speed.json", arguments.networks))
    if "train" in arguments.what:
        index = index_of(folder)
        for seed in arguments.seeds:
            for network in arguments.networks:
                train_network(folder, index, network, seed)
    if "drive" in arguments.what:
        print_drives(folder, arguments.networks, arguments.seeds)


# Speed


def speeds(path: Path, networks: list[str]) -> dict[str, dict[str, Any]]:
    """The size and speed of each network, measured now or in an earlier call."""
    results: dict[str, dict[str, Any]] = json.loads(path.read_text()) if path.exists() else {}
    torch.set_num_threads(1)
    contenders = {name: Contender(name) for name in networks if name not in results}
    for _ in range(ROUNDS):
        for contender in contenders.values():
            contender.take_turn()
    results |= {name: contender.result() for name, contender in contenders.items()}
    with atomic_file(path, overwrite=True) as part:
        part.write_text(json.dumps(results, indent=2) + "\n")
    return {name: results[name] for name in networks}


class Contender:
    """A network that trains and predicts in turns with the others."""

    def __init__(self, name: str) -> None:
        config = TrainConfig(network=name, threads=1, device="cpu")
        machine = choose_machine(config)
        self.choice: NetworkChoice = choose_network(config)
        self.picture: PictureSpec = self.choice.picture
        self.arithmetic = machine.arithmetic
        network = self.choice.build().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.parameters = sum(parameter.numel() for parameter in network.parameters())
        optimizer = Adam(network.parameters(), config.rate)
        height, width, _ = self.picture.shape
        pictures = torch.randint(0, 256, (PICTURES, height, width, 3), dtype=torch.uint8).permute(0, 3, 1, 2)
        steering = torch.rand(PICTURES) * 2 - 1

        def step() -> None:
            network.train()
            training_step(network, optimizer, pictures, steering, dtype=machine.dtype, micro_batch=PICTURES)

        self._step = step
        precisions: tuple[Precision, ...] = ("auto", "float32")
        self._pilots = {precision: self._pilot(precision) for precision in precisions}
        self._crop = np.random.default_rng(0).integers(0, 256, self.picture.shape, np.uint8)
        self._step_s: list[float] = []
        self._predict_s: dict[str, list[float]] = {precision: [] for precision in precisions}

    def take_turn(self) -> None:
        self._step_s.append(processor_s(self._step))
        for name, pilot in self._pilots.items():
            times_s = [processor_s(lambda: pilot.predict(self._crop)) for _ in range(PREDICTIONS)]  # noqa: B023
            self._predict_s[name].append(statistics.median(times_s))

    def result(self) -> dict[str, Any]:
        return {
            "parameters": self.parameters,
            "picture": f"{self.picture.width_px} x {self.picture.height_px} {self.picture.channels}",
            "mb": 4 * self.parameters / 1e6,
            "samples_per_cpu_s": PICTURES / min(self._step_s),
            "arithmetic": self.arithmetic,
            "ms": {name: 1e3 * min(values) for name, values in self._predict_s.items()},
        }

    def _pilot(self, precision: Precision) -> Pilot:
        dtype = training_dtype(precision, torch.device("cpu"))
        return Pilot(self.choice.build(), dtype=dtype, picture=self.picture)


def processor_s(action: Callable[[], object]) -> float:
    before_s = time.thread_time()
    action()
    return time.thread_time() - before_s


def print_speed(results: dict[str, dict[str, Any]]) -> None:
    print_head("network", "it sees", "parameters", "weights", "samples a second", "ms a picture", "in float32")
    for name, result in results.items():
        print_row(
            f"`{name}`",
            result["picture"],
            f"{result['parameters']:,}",
            f"{result['mb']:.1f} MB",
            f"{result['samples_per_cpu_s']:,.0f}",
            f"{result['ms']['auto']:.2f}",
            f"{result['ms']['float32']:.2f}",
        )


# Driving


def index_of(folder: Path) -> Path:
    """The index of half a lap of each track."""
    sessions = [folder / "sessions" / f"{track}.mcap" for track in RECORDED]
    for session in sessions:
        if not session.exists():
            output_of(folder, "bc-record", session.stem, "--track", session.stem, "--laps", 0.5)
    return build_index(sessions, folder / "index", IndexConfig.of("original")).path


def train_network(folder: Path, index: Path, network: str, seed: int) -> None:
    run = folder / "runs" / f"{network}-{seed}"
    config = replace(TrainConfig.of("original"), network=network, seed=seed)
    if not run.exists():
        train(index, run, config)
    elif len(read_history(run)[0].epochs) < config.epochs:
        train(index, run, config, resume=True)


def print_drives(folder: Path, networks: list[str], seeds: list[int]) -> None:
    print_head("network", "seed", "RMSE held out", *DRIVEN)
    for network in networks:
        for seed in seeds:
            run = folder / "runs" / f"{network}-{seed}"
            best = read_history(run)[0].best
            rmse_deg = math.nan if best is None else best.measures.network.rmse_deg
            drives = [driven(run, track) for track in DRIVEN]
            cells = [
                f"{drive['autonomy_percent']:.0f} %, {drive['interventions']}, {drive['mean_offset']:.2f}"
                for drive in drives
            ]
            print_row(f"`{network}`", seed, f"{rmse_deg:.2f} deg", *cells)
    print("\nCells: autonomy, interventions, mean distance from the centre line as a share of the half width.")


def driven(run: Path, track: str) -> dict[str, Any]:
    """The result of `bc-eval` for a lap, from now or from an earlier call."""
    kept = run / f"drive-{track.replace(':', '-')}.json"
    if not kept.exists():
        words = ("--tracks", track, "--drives", "drives", "--force", "--json")
        output = output_of(run, "bc-eval", "drive", run.absolute(), *words)
        with atomic_file(kept, overwrite=True) as part:
            part.write_text(output)
    results: dict[str, Any] = json.loads(kept.read_text())
    return results


if __name__ == "__main__":
    main()
