"""Provenance: the settings of a run, its exact training data, and the versions that trained it."""

from __future__ import annotations

import platform
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import msgspec
import torch

from common.stored_settings import settings_from
from common.versions import TOOLKIT, version_of
from dataset import Samples
from dataset.config import EARLIER_ALTERATIONS
from model.config import TrainConfig
from model.device import Machine
from model.errors import RunError
from model.network.choice import NetworkChoice
from model.runs.network_of_run import stored_targets
from model.runs.run_folder import CONFIG, load_config, run_name, weights_checksum
from model.runs.run_inputs import relative_place


class StoredLog(msgspec.Struct):
    """A log of the index that a run was trained on, as its config.json stores it."""

    fingerprint: str


class StoredData(msgspec.Struct):
    """The index that a run was trained on, as its config.json stores it."""

    settings: dict[str, Any]
    logs: dict[str, StoredLog]


def provenance(
    samples: Samples, config: TrainConfig, network: NetworkChoice, parameters: int, machine: Machine
) -> dict[str, Any]:
    """The part of a run's config.json that is about its training."""
    return {
        "network": network.description,
        "targets": list(config.targets),
        "parameters": parameters,
        "training": asdict(config),
        "machine": {  # its settings that change the last bits of the weights; "training" has the others
            "device": machine.device.type,
            "arithmetic": machine.arithmetic,
            "micro_batch": machine.micro_batch,
            "threads": torch.get_num_threads(),
            "torch": torch.__version__,
        },
        "data": {
            "fingerprint": samples.fingerprint,
            "content_fingerprint": samples.content_fingerprint,
            "targets_fingerprint": samples.targets_fingerprint(config.targets),
            **samples.metadata,
        },
        "versions": versions(),
    }


def init_provenance(init: Path, run: Path) -> dict[str, Any]:
    """The weights that `run` starts from, and all data that they were trained on."""
    before = load_config(init)
    earlier = before.get("init")
    data = earlier.get("data") if isinstance(earlier, dict) else None
    return {
        "run": run_name(init),
        "place": relative_place(run, init),
        "weights_sha256": weights_checksum(init),
        "data": [before.get("data"), *(data if isinstance(data, list) else [])],
    }


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that training depends on."""
    return {
        "python": platform.python_version(),
        **{name: version_of(name) for name in (TOOLKIT, "numpy", "pyarrow")},
        "torch": torch.__version__,  # with its build, as +cpu or +cu130, which the package's version may lack
        "opencv": cv2.__version__,
    }


def training_of(stored: dict[str, Any], run: Path) -> TrainConfig:
    """The settings in a run's config. Raises RunError if they cannot be used."""
    settings: Any = stored.get("training")
    match settings:
        case {"alter_each_epoch": ["all"]} if "light" not in settings:  # version 0.3
            settings = {**settings, "alter_each_epoch": list(EARLIER_ALTERATIONS)}
    try:
        return settings_from(TrainConfig, settings)
    except ValueError as error:
        raise RunError(f"{run / CONFIG}: its training settings cannot be used ({error})") from None


def is_trained_on(stored: dict[str, Any], run: Path, samples: Samples) -> bool:
    """True if a run with this config was trained on these samples, even if their logs were rewritten since. Raises
    RunError if the config does not record its samples."""
    try:
        data = stored["data"]
        labels = samples.targets_fingerprint(stored_targets(stored, run))
        if str(data.get("targets_fingerprint", "")) != labels:  # earlier versions: steering only
            return False
        if str(data["fingerprint"]) == samples.fingerprint:
            return True
        # earlier versions did not store the fingerprint of the content
        return str(data.get("content_fingerprint", "")) == samples.content_fingerprint
    except (KeyError, TypeError, AttributeError):
        raise RunError(f"{run / CONFIG}: does not name the data that the run was trained on") from None
