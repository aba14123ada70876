"""Training with the mean squared error and Adam on the balanced index.

bc-train --epochs 10
"""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from rich.progress import Progress

from common import Skipped
from common.errors import first_of, printable
from common.interrupts import stop_signals
from common.location import local_path
from common.progress import progress_bar
from dataset import IndexConfig, Samples
from dataset.picture_spec import PictureSpec
from dataset.prediction_targets import TARGETS, TargetName
from model.config import TrainConfig
from model.device import choose_machine
from model.errors import RunError
from model.network.choice import NetworkChoice, choose_network, chosen_picture
from model.network.names import is_own
from model.runs.car_of_run import refuse_other_steering
from model.runs.network_of_run import choice_of, light_of, network_flag, picture_of, stored_network, stored_targets
from model.runs.provenance import init_of, init_provenance, is_trained_on, provenance, relative_place, training_of
from model.runs.run_files import locked_for_training, run_argument
from model.runs.run_folder import (
    CONFIG,
    WEIGHTS,
    config_folder,
    create_run,
    has_nothing_saved,
    load_config,
    load_weights,
    picture_of_run,
    refuse_existing_run,
    removed_unless_saved,
    write_config,
)
from model.runs.training_progress import Epoch, Listener
from model.training.loop import Listeners, TrainingLoop
from model.training.run_writer import RunWriter
from model.training.validation import validation_notices


@dataclass(frozen=True)
class Trained:
    run: Path
    epochs: list[Epoch]  # of this call
    skipped: list[Skipped]  # pictures that did not decode
    notices: list[str]  # warnings to read before the run is used
    remarks: list[str]  # possible improvements
    best_epoch: int  # its weights drive
    is_stopped_early: bool


def train(
    index: Path | str,
    run: Path | str,
    config: TrainConfig | None = None,
    listeners: Sequence[Listener] = (),
    *,
    init: Path | str | None = None,
    like: Path | str | None = None,
    resume: bool = False,
    show_progress: bool = True,
) -> Trained:
    """Train a network on `index` and keep it in the new folder `run`.

    `init` is a run from whose weights the training starts. `like` is a run that gives the arithmetic and the
    micro-batch if `config` leaves them automatic. `resume` continues `run` where it was stopped or killed; on the
    same processor with the same number of threads, the weights are those of an uninterrupted training. A run that
    was killed before its first checkpoint restarts from its seed. `listeners` receive the progress; their errors
    do not end the training.

    Sets PyTorch's number of threads, and on a GPU its precision of float32, for this process. Ctrl-C ends the
    training after the current batch, saves it, and raises KeyboardInterrupt. The code of a user's own network is
    run: for a new run because `config` names it, for a resumed run only if `load_code` loaded it before.

    Raises DatasetError if the index does not fit its logs; RunError if the run exists, cannot continue, is damaged
    or diverges, if its network cannot be trained, or if the disk is full.
    """
    index, run, init = local_path(index), Path(run), None if init is None else Path(init)
    stored = load_config(run) if resume else {}
    if resume:
        config = resumed_settings(run, stored, config)
    else:
        refuse_existing_run(run)
    config = config or TrainConfig()
    before = stored if resume or like is None else load_config(Path(like))
    machine = choose_machine(config, before.get("machine"))
    network = choice_of(stored, run) if resume else choose_network(config)
    picture = picture_of_run(run) if resume else chosen_picture(config, network)
    parameters = network.try_out(picture, machine.device)
    if init is not None:
        refuse_other_network(init, network, picture, config.targets)
    with (
        Samples(index) as samples,
        progress_bar() if show_progress else Progress(disable=True) as bar,
        contextlib.ExitStack() as stack,
    ):
        samples.refuse_missing(config.targets)
        config = config.with_passes(len(samples.of_split("train", ["session"])))
        notices = _target_notices(samples, config.targets)
        guarded = Listeners(listeners, notices)
        stack.callback(guarded.close)
        on_gpu = [machine.device] if machine.device.type == "cuda" else []
        stack.enter_context(torch.random.fork_rng(devices=on_gpu))  # keep the caller's random state
        writer = RunWriter(run)
        origin = {"index": relative_place(run, index), **provenance(samples, config, network, parameters, machine)}
        if init is not None:
            refuse_other_steering(init, samples.max_steering_deg, str(samples.path))
        if resume:
            refuse_other_samples(run, stored, samples)
            stack.enter_context(locked_for_training(run))
            begins = has_nothing_saved(run)
            init = init_of(run, run.parent) if begins else None
        else:
            begins = True
            if init is not None:
                origin["init"] = init_provenance(init, run)
            create_run(run, origin, picture, b"" if network.code is None else network.code.source)
            stack.enter_context(removed_unless_saved(run, lambda: writer.has_saved))
            stack.enter_context(locked_for_training(run))
        loop = TrainingLoop(samples, writer, config, network, picture, machine, guarded, bar)
        notices += validation_notices(samples, loop.validation, init)
        remarks = [] if resume else _recipe_remarks(samples, config)
        if begins:
            if init is not None:
                load_weights(init, loop.network)
            if resume:
                loop.cut_history()
                write_config(run, {**stored, **origin})
            loop.begin()
        else:
            loop.resume()
            if not loop.is_over:
                remarks += arithmetic_remarks(run, stored, origin["machine"])
                write_config(run, resumed_config(stored, origin))
        with stop_signals() as stopped:
            loop.train(stopped)
        return Trained(
            run, loop.history, loop.skipped, notices, remarks, loop.position.best_epoch, loop.is_stopped_early
        )


def _target_notices(samples: Samples, targets: Sequence[TargetName]) -> list[str]:
    """A notice for each target that some sessions lack: from these sessions, only the other targets are learnt.

    Raises RunError if no session has a target.
    """
    columns = [TARGETS[name].label_column for name in targets[1:]]
    if not columns:
        return []
    training = samples.of_split("train", ["session", "split", *columns])
    session = np.asarray(training["session"])
    notices = []
    for name in targets[1:]:
        is_known = np.isfinite(samples.target_labels(training, name))
        labelled = set(session[is_known].tolist())
        if not labelled:
            raise RunError(f"{samples.path}: no session has a {name}; leave it out of --targets")
        if missing := sorted(set(session.tolist()) - labelled):
            others = ", ".join(other for other in targets if other != name)
            notices.append(f"{samples.path}: no {name} in {first_of(missing)}, which train only {others}")
    return notices


def _recipe_remarks(samples: Samples, config: TrainConfig) -> list[str]:
    """A remark if the index and the training have different recipes."""
    built = samples.metadata["settings"].get("recipe", "original")  # earlier versions had only this recipe
    wanted = IndexConfig.of(config.recipe).recipe
    if built == wanted:
        return []
    return [
        f"{samples.path}: built with the recipe {built}, trained with {config.recipe}; to use one recipe, give"
        f" bc-train --recipe {built}, or rebuild the index: `bc-index --recipe {wanted}`"
    ]


MAY_CHANGE: Final = ("epochs", "patience", "device", "threads", "picture_memory_mb")
"""Settings that may change when a run is resumed."""


def resumed_settings(run: Path, stored: dict[str, Any], config: TrainConfig | None) -> TrainConfig:
    """The settings with which a run with the config.json `stored` continues: `config`, by default its own.

    Raises RunError if `config` changes a setting that may not change.
    """
    before = training_of(stored, run)
    if before.targets != (answered := stored_targets(stored, run)):
        raise RunError(
            f"{run / CONFIG}: its network answers {' '.join(answered)}, but its training settings are for"
            f" {' '.join(before.targets)}; copy it again, or train the run again"
        )
    if config is None:
        return before
    wanted = asdict(config)
    for name, value in asdict(before).items():
        if name == "network" and is_own(value) and is_own(wanted[name]):
            continue  # the file may have moved; `choice_of` checks that its content is the same
        if name not in MAY_CHANGE and wanted[name] != value:
            flag = f"--{name.replace('_', '-')}"
            raise RunError(
                f"{run}: began with {flag} {value} and keeps it when resumed; for {flag} {wanted[name]} train"
                f" another run from its weights: `bc-train continue {run_argument(run)}`"
            )
    return config if config.epochs else replace(config, epochs=before.epochs)


def refuse_other_samples(run: Path, stored: dict[str, Any], samples: Samples) -> None:
    """Raise RunError if these are not the samples that the run was trained on."""
    if not is_trained_on(stored, run, samples):
        has_weights = (run / WEIGHTS).exists()
        or_init = (
            f", or train another run from its weights: `bc-train continue {run_argument(run)}`"
            if has_weights
            else ""
        )
        raise RunError(
            f"{samples.path}: not the samples that {run} was trained on; `bc-train resume {run_argument(run)}"
            f" --index {shlex.quote(f'{samples.path.parent}-{run.name}')}` rebuilds its samples{or_init}"
        )


def arithmetic_remarks(run: Path, stored: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """A remark if the machine settings `now` differ from those with which the run began."""
    before = stored.get("machine")
    before = before if isinstance(before, dict) else {}
    changed = [f"{name} {before.get(name)} to {now[name]}" for name in now if before.get(name) != now[name]]
    if not changed:
        return []
    return [f"{run}: continues with other arithmetic ({', '.join(changed)}): the weights will differ"]


def resumed_config(stored: dict[str, Any], now: dict[str, Any]) -> dict[str, Any]:
    """The config.json of a resumed run: the settings of its start and of each continuation."""
    before = stored.get("resumed")
    return {
        **stored,
        **{name: now[name] for name in ("index", "training")},
        "resumed": [
            *(before if isinstance(before, list) else []),
            {name: now[name] for name in ("machine", "versions")},
        ],
    }


def refuse_other_network(
    init: Path, network: NetworkChoice, picture: PictureSpec, targets: tuple[TargetName, ...]
) -> None:
    """Raise RunError if a training of `network` cannot start from the weights of the run `init`."""
    config, folder = load_config(init), config_folder(init)
    before = stored_network(config, folder)
    if before.name != network.name and not (is_own(before.name) and is_own(network.name)):
        raise RunError(
            f"{init}: its network is {printable(before.name)}, and {printable(network.name)} cannot start from its"
            f" weights; give {network_flag(before, folder)}, or continue another run"
        )
    answered = stored_targets(config, folder)
    if answered != targets:
        raise RunError(
            f"{init}: its network answers {' '.join(answered)}, and this one {' '.join(targets)}; give --targets"
            f" {' '.join(answered)}"
        )
    own = picture_of(config, folder)
    if own != picture:
        raise RunError(
            f"{init}: its network sees {own}, and this one {picture}; give --picture-px {own.width_px}"
            f" {own.height_px} --crop-rows {own.crop_top} {own.crop_bottom} --channels {own.channels}"
        )
    light = light_of(config, folder)
    if light != light_of({"network": network.description}, folder):
        raise RunError(f"{init}: its network sees pictures with --light {light}; give this flag")
