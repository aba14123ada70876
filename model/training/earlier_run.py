"""Checks of an earlier run, from whose weights a training starts or which it resumes."""

from __future__ import annotations

import shlex
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

from common.errors import printable
from dataset import Samples
from dataset.picture_spec import PictureSpec
from dataset.prediction_targets import TargetName
from model.config import TrainConfig
from model.errors import RunError
from model.network.choice import NetworkChoice
from model.network.names import is_own
from model.runs.network_of_run import light_of, network_flag, picture_of, stored_network, stored_targets
from model.runs.provenance import is_trained_on, training_of
from model.runs.run_arguments import run_argument
from model.runs.run_folder import CONFIG, WEIGHTS, config_folder, load_config

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
