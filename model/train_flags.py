"""The flags of `bc-train`, their defaults, and the combinations that are refused."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, ClassVar, Final

import tyro

from common.errors import UsageError, counted
from common.location import local_path
from common.process_settings import usable_cores
from common.recipe import recipe_given
from model.config import TrainConfig
from model.runs.run_arguments import RUNS

_MOST_PER_CORE: Final = 16
"""Threads for each core. A run of a larger machine may be resumed with its number of threads, on which rounding
depends."""


@dataclass(frozen=True)
class Train:
    """Train the network on the index and keep the run in runs/NAME/.

    A missing index is built from all sessions. Ctrl-C stops after the current batch; --resume continues.
    `bc-train export RUN` writes a network for other programs (--onnx) or the Hugging Face hub (--hub).
    """

    RARE: ClassVar[str] = "tensorboard listener sessions drives"
    REMOVED: ClassVar[Mapping[str, str]] = {
        "--ray": "one training is one process; leave it out",
        "--copy-to": "`bc-copy runs/NAME s3://BUCKET/runs/NAME --follow` copies the run while it is trained",
    }
    name: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    """Name of the run; by default date, time and six random digits."""
    resume: Annotated[str | None, tyro.conf.arg(metavar="RUN")] = None
    """Resume this run; more --epochs make it longer."""
    init: Annotated[str | None, tyro.conf.arg(metavar="RUN")] = None
    """Start from this run's weights."""
    on: Annotated[tuple[str, ...], tyro.conf.arg(metavar="SESSION [SESSION ...]")] = ()
    """Train only on these sessions; builds index-NAME."""
    takeovers: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="LOG [LOG ...]")] = ()
    """Add these drives' takeovers to the samples of --init."""
    like: Annotated[str | None, tyro.conf.arg(metavar="RUN")] = None
    """Use this run's samples, and its settings except for flags that you give."""
    tensorboard: bool = False
    """Also write the curves for TensorBoard."""
    listener: str | None = None
    """Your code that receives the progress: FILE.py:CLASS or MODULE:CLASS."""
    index: Path = Path("index")
    """The index."""
    sessions: Path = Path("sessions")
    """The logs, if the index must be built."""
    drives: Path = Path("drives")
    """The drives that --init learnt from."""
    runs: Path = RUNS
    """Folder of the runs."""
    config: tyro.conf.OmitArgPrefixes[TrainConfig] = field(default_factory=TrainConfig)


def refuse_contradictions(config: Train) -> None:
    """Raise UsageError for flags that contradict each other."""
    if os.environ.get("WORLD_SIZE", "1") != "1":
        raise UsageError("one training is one process: start it without torchrun (WORLD_SIZE)")
    others = {"--name": config.name, "--init": config.init, "--like": config.like}
    if config.resume is not None and (given := [flag for flag, value in others.items() if value]):
        make = "makes" if len(given) == 1 else "make"
        raise UsageError(f"{' and '.join(given)} {make} a new run, --resume continues one: give one of them")
    if config.takeovers and config.init is None:
        raise UsageError("--takeovers continues a run: give it with --init RUN")
    if (config.on or config.takeovers) and (config.resume is not None or config.like is not None):
        raise UsageError(
            "--on and --takeovers choose the samples; with --resume and --like they are already chosen"
        )
    if config.on and config.takeovers:
        raise UsageError("--on, --takeovers: give one of them")
    if config.config.threads and config.config.threads > _MOST_PER_CORE * (cores := usable_cores()):
        most = f"at most {_MOST_PER_CORE * cores}, as this process has {counted(cores, 'core')}"
        raise UsageError(f"--threads {config.config.threads}: expected {most}; more are slower")
    if Path(config.name).name != config.name or config.name.startswith((".", "-")):
        raise UsageError(f"--name {config.name!r}: expected a plain name; give the folder with --runs")


def defaults() -> Train:
    """The defaults of the flags: with --resume or --like, the settings and places of that run; with --init, its
    light.

    Raises UsageError for --like with another --recipe: the recipe would change no setting.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    for flag in ("--resume", "--like", "--init", "--network", "--index"):
        parser.add_argument(flag)
    parser.add_argument("--runs", type=local_path, default=RUNS)
    parser.add_argument("--sessions", type=local_path)
    settings = TrainConfig.of(recipe_given())
    with contextlib.suppress(argparse.ArgumentError):  # tyro prints what is wrong
        flags, _ = parser.parse_known_args()
        name, runs = flags.resume if flags.resume is not None else flags.like, flags.runs
        if name:
            from model.runs.network_of_run import choice_of, is_own_network
            from model.runs.provenance import training_of
            from model.runs.run_folder import find_any_run, load_config
            from model.runs.run_inputs import init_of, local_index_of, sessions_of

            run = find_any_run(name, runs)
            stored = load_config(run)
            if is_own_network(stored) and flags.network is None:
                choice_of(stored, run)  # raises RunError: a run's code runs only if the user names it
            settings = training_of(stored, run)
            if flags.resume is None and recipe_given(settings.recipe) != settings.recipe:
                raise UsageError("--recipe with --like: that run's settings are repeated; leave out one of them")
            init = init_of(run, runs) if flags.resume is None else None
            return Train(
                init=str(init) if init is not None else None,
                index=Train.index if flags.index else local_index_of(run) or Train.index,
                sessions=flags.sessions or sessions_of(run) or Train.sessions,
                config=settings,
            )
        if flags.init:
            from model.errors import RunError
            from model.runs.network_of_run import light_of
            from model.runs.run_folder import find_run, load_config

            with contextlib.suppress(RunError):  # the command reports it, after other mistakes in its flags
                init = find_run(flags.init, runs)
                settings = replace(settings, light=light_of(load_config(init), init))
    return Train(config=settings)
