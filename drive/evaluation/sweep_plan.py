"""The plan of a sweep, read from FILE.toml: trainings, each with a name and settings, and drives.

seeds = [0, 1, 2]

[train]                    # of all: settings of bc-train, by the names of its flags
epochs = 5

[grid]                     # every combination; or a list of them: [[trainings]]
rate = [1e-4, 3e-4]
network = ["original", "pilotnet"]

[drive]                    # without it, nothing is driven
simulator = ["lake", "mountain"]
speed = [10, 15]
laps = 1
"""

from __future__ import annotations

import hashlib
import itertools
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec

from common.errors import UserError, did_you_mean, printable
from common.stored_settings import read_toml, settings_from
from drive.config import DriveConfig
from drive.evaluation.closed_loop import PlannedDrive
from drive.evaluation.simulator_process import BuiltInSimulator
from model.config import TrainConfig

_EXPECTED: Final = "a file of settings was expected, as `bc-sweep --help` shows one"
_MAX_TRAININGS: Final = 10_000
_MAX_NAME: Final = 100
_NOT_IN_NAMES: Final = re.compile(r"[^A-Za-z0-9.+-]+")


@dataclass(frozen=True)
class Training:
    run: str  # its folder's name
    varied: str  # what it does not share with all others, but for the seed: "rate 0.0003, network pilotnet"
    config: TrainConfig


@dataclass(frozen=True)
class SweepPlan:
    name: str
    trainings: tuple[Training, ...]
    drives: tuple[PlannedDrive, ...]


class _Drive(msgspec.Struct, forbid_unknown_fields=True):
    simulator: Annotated[list[str], msgspec.Meta(min_length=1)]
    speed: Annotated[tuple[float, ...], msgspec.Meta(min_length=1)] = (10.0,)
    laps: float = 1.0


class _File(msgspec.Struct, forbid_unknown_fields=True):
    seeds: Annotated[tuple[Annotated[int, msgspec.Meta(ge=0)], ...], msgspec.Meta(min_length=1)] = (0,)
    train: dict[str, Any] = {}
    grid: dict[str, Annotated[list[Any], msgspec.Meta(min_length=1)]] = {}
    trainings: list[dict[str, Any]] = []
    drive: _Drive | None = None


def read_sweep(path: Path) -> SweepPlan:
    """Raises UserError for a file that is none, or settings that bc-train or bc-eval would not take."""
    try:
        stored = msgspec.convert(read_toml(path), _File)
    except OSError as error:
        meant = did_you_mean(str(path), map(str, path.parent.glob("*.toml")))
        raise UserError(f"{path}: cannot be read ({error.strerror}); {meant or _EXPECTED}") from None
    except (ValueError, RecursionError) as error:  # also those of TOML and msgspec
        why = printable(" ".join(str(error).split()))
        raise UserError(f"{path}: not a sweep ({why}); {_EXPECTED}") from None
    if stored.grid and stored.trainings:
        raise UserError(f"{path}: [grid] makes every combination, [[trainings]] lists them: give one of the two")
    name = _NOT_IN_NAMES.sub("_", path.stem)
    trainings = tuple(
        _training(path, name, stored.train, varied, seed)
        for varied in stored.trainings or _combinations(path, stored)
        for seed in stored.seeds
    )
    names = Counter(training.run for training in trainings)
    if twice := next((run for run, count in names.items() if count > 1), None):
        raise UserError(f"{path}: two trainings are the same ({twice}): give each once")
    drives: list[PlannedDrive] = []
    if stored.drive is not None:
        configs = [DriveConfig(set_speed_mph=speed) for speed in stored.drive.speed]
        tracks = [BuiltInSimulator(track, stored.drive.laps) for track in stored.drive.simulator]
        drives = [(track, config) for config in configs for track in tracks]
    return SweepPlan(name, trainings, tuple(drives))


def _combinations(path: Path, stored: _File) -> list[dict[str, Any]]:
    count = len(stored.seeds)
    for values in stored.grid.values():
        count *= len(values)
    if count > _MAX_TRAININGS:
        raise UserError(f"{path}: {count:,} trainings; at most {_MAX_TRAININGS:,} were expected")
    return [dict(zip(stored.grid, chosen, strict=True)) for chosen in itertools.product(*stored.grid.values())]


def _training(path: Path, sweep: str, of_all: Mapping[str, Any], varied: Mapping[str, Any], seed: int) -> Training:
    given = {name.replace("-", "_"): value for name, value in {**of_all, **varied}.items()}
    if "seed" in given:
        raise UserError(f"{path}: seed: give seeds = [...] at the top: every training is repeated with each")
    try:
        base = TrainConfig.of(given.get("recipe", TrainConfig.recipe))
        config = settings_from(TrainConfig, {**asdict(base), **given, "seed": seed})
    except ValueError as error:
        raise UserError(f"{path}: {error}") from None
    parts = [sweep, *(f"{name}_{_text(value)}" for name, value in varied.items())]
    run = "-".join(_NOT_IN_NAMES.sub("_", part) for part in parts)
    if len(run) > _MAX_NAME:  # for example the path of a network of one's own
        run = f"{run[:_MAX_NAME]}-{hashlib.sha256(run.encode()).hexdigest()[:8]}"
    texts = ", ".join(f"{name} {_text(value)}" for name, value in varied.items())
    return Training(f"{run}-seed{seed}", texts, config)


def _text(value: object) -> str:
    return " ".join(map(_text, value)) if isinstance(value, list) else str(value)
