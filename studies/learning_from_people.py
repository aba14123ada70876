"""Which recipe learns best from people? Recipes on recordings of people, measured on unseen blocks and recordings.

python studies/learning_from_people.py FOLDER sessions/lake.mcap sessions/jungle.mcap ...
    [--across lake:other_lake ...] [--recipes original people ...] [--seeds 0 1 2] [--epochs 6]
    [--other-blocks]

For each recipe and seed, a network is trained on the training blocks of all logs and measured on the blocks held
out. For each pair of --across, a network is trained on the first session and measured on the whole second session,
and the other way round. Errors are divided by those of always predicting the mean of the same frames; with several
seeds, the table shows their mean (minimum to maximum). "Best by a scale" is the smallest RMSE that any scale and
offset of the same answers could have, sqrt(1 - correlation^2). --other-blocks holds out other blocks for each
seed, so that the chance of the split averages out, too. Existing results in FOLDER are not computed again.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from kept_result import keep
from printed_table import print_head, print_row

from dataset import IndexConfig, build_index
from model import TrainConfig, train
from model.evaluation.evaluate import evaluate, evaluate_sessions
from model.metrics import Measures

ORIGINAL: Final = IndexConfig.of("original"), TrainConfig.of("original")
PEOPLE: Final = IndexConfig(), TrainConfig.of("people")
HALF_BALANCED: Final = replace(PEOPLE[0], per_bin=1000, max_uses=1)

RECIPES: Final[Mapping[str, tuple[IndexConfig, TrainConfig]]] = {
    "original": ORIGINAL,
    "original + labels": (PEOPLE[0], ORIGINAL[1]),
    "original + answers": (ORIGINAL[0], replace(ORIGINAL[1], answers="natural")),
    "original + averaged": (ORIGINAL[0], replace(ORIGINAL[1], average_steps=PEOPLE[1].average_steps)),
    "original + keep rmse": (ORIGINAL[0], replace(ORIGINAL[1], keep="rmse")),
    "original + keep last": (ORIGINAL[0], replace(ORIGINAL[1], keep="last")),
    "people": PEOPLE,
    "people, as learnt": (PEOPLE[0], replace(PEOPLE[1], answers="as-learnt")),
    "people, half balanced": (HALF_BALANCED, PEOPLE[1]),
    "people, dropout 0.7": (PEOPLE[0], replace(PEOPLE[1], dropout=0.7)),
    "people, small": (PEOPLE[0], replace(PEOPLE[1], network="small")),
    "people, half balanced, small": (HALF_BALANCED, replace(PEOPLE[1], network="small")),
    "people, not balanced, small": (replace(PEOPLE[0], balance=False), replace(PEOPLE[1], network="small")),
    "people, pilotnet": (PEOPLE[0], replace(PEOPLE[1], network="pilotnet")),
    "people, resnet18": (PEOPLE[0], replace(PEOPLE[1], network="resnet18")),
    "people, as recorded": (replace(PEOPLE[0], labels="as-recorded"), PEOPLE[1]),
    "people, keep rmse": (PEOPLE[0], replace(PEOPLE[1], keep="rmse")),
    "people, keep last": (PEOPLE[0], replace(PEOPLE[1], keep="last")),
    "people, not balanced": (replace(PEOPLE[0], balance=False), PEOPLE[1]),
    "people, side 0.1": (replace(PEOPLE[0], side_correction=0.1), PEOPLE[1]),
}

MEASURED: Final[Mapping[str, Callable[[Measures], float]]] = {
    "RMSE": lambda measures: measures.network.rmse_deg / measures.mean.rmse_deg,
    "error on turns": lambda measures: measures.network.turning_mae_deg / measures.mean.turning_mae_deg,
    "correlation": lambda measures: measures.network.correlation,
    "best by a scale": lambda measures: math.sqrt(1 - max(0.0, measures.network.correlation) ** 2),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--across", nargs="+", default=[], metavar="A:B", help="sessions of the same road")
    parser.add_argument("--recipes", nargs="+", default=["original", "people"], choices=RECIPES)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--epochs", type=int, default=6)
    parser.add_argument("--other-blocks", action="store_true")
    arguments = parser.parse_args()
    logs: dict[str, Path] = {log.stem: log.resolve() for log in arguments.logs}
    pairs = [(first, second) for first, _, second in (pair.partition(":") for pair in arguments.across)]
    if any(name not in logs for pair in pairs for name in pair):
        parser.error(f"--across: expected two names of logs, for example {':'.join(list(logs)[:2])}")
    parts: list[Part] = [Part("held-out blocks of ", tuple(logs.values()))]
    for learnt, unseen in [*pairs, *((second, first) for first, second in pairs)]:
        parts.append(Part(f"{learnt} -> ", (logs[learnt],), (logs[unseen],)))
    results: dict[str, dict[str, list[dict[str, float]]]] = {}
    for seed in arguments.seeds:
        for part in parts:
            if arguments.other_blocks and not part.unseen:
                part = replace(part, block_seed=seed)
            for recipe in arguments.recipes:
                measured = measures(arguments.folder, recipe, seed, arguments.epochs, part)
                for session, values in measured.items():
                    results.setdefault(part.heading + session, {}).setdefault(recipe, []).append(values)
            print_table(results)


@dataclass(frozen=True)
class Part:
    """The logs of a training, and of the measurement: the logs `unseen` or, without any, the blocks held out."""

    heading: str
    learnt: tuple[Path, ...]
    unseen: tuple[Path, ...] = ()
    block_seed: int = 0


def measures(folder: Path, recipe: str, seed: int, epochs: int, part: Part) -> dict[str, dict[str, float]]:
    """Train and measure. Returns the measures by session."""
    learnt, unseen = part.learnt, part.unseen
    index_config, train_config = RECIPES[recipe]
    blocks = [f"blocks{part.block_seed}"] if part.block_seed else []
    slug = recipe.replace(" + ", "+").replace(", ", "-").replace(" ", "-")
    name = "-".join([slug, *sorted(log.stem for log in learnt), *blocks])
    result = folder / "results" / f"{name}-{epochs}-{seed}.json"
    if not result.exists():
        # with unseen logs, the held-out frames are not needed to choose an epoch, but an index must hold out some
        share = 0.1 if unseen else index_config.validation_share
        index_config = replace(index_config, validation_share=share, seed=part.block_seed)
        index = build_index(list(learnt), folder / f"index-{name}", index_config).path
        run = folder / "runs" / f"{name}-{epochs}-{seed}"
        print(run.name, file=sys.stderr, flush=True)
        config = replace(train_config, epochs=epochs, seed=seed)
        train(index, run, config, resume=run.exists())
        evaluation = evaluate_sessions(run, unseen) if unseen else evaluate(run, index)
        values = {session: values_of(measured) for session, measured in evaluation.sessions.items()}
        keep(result, values)
    return dict(json.loads(result.read_text()))


def values_of(measures: Measures) -> dict[str, float]:
    return {name: value(measures) for name, value in MEASURED.items()}


def print_table(results: Mapping[str, Mapping[str, Sequence[Mapping[str, Any]]]]) -> None:
    print()
    print_head("measured on", "recipe", *MEASURED)
    recipes = list(dict.fromkeys(recipe for by_recipe in results.values() for recipe in by_recipe))
    for session, by_recipe in results.items():
        for recipe, seeds in by_recipe.items():
            print_row(session, recipe, *cells(seeds))
    for recipe in recipes:
        seeds = [seed for by_recipe in results.values() for seed in by_recipe.get(recipe, ())]
        print_row("all", recipe, *(f"{mean(seed[name] for seed in seeds):.2f}" for name in MEASURED))


def cells(seeds: Sequence[Mapping[str, float]]) -> list[str]:
    columns = [[seed[name] for seed in seeds] for name in MEASURED]
    return [f"{mean(values):.2f} ({min(values):.2f} to {max(values):.2f})" for values in columns]


def mean(values: Iterable[float]) -> float:
    numbers = [value for value in values if not math.isnan(value)]
    return statistics.fmean(numbers) if numbers else math.nan


if __name__ == "__main__":
    main()
