"""Where a run comes from: its settings, the exact bytes that it saw, and the versions that trained it."""

from __future__ import annotations

import platform
from typing import Any

import cv2
import torch

from common.stored_settings import settings_from
from common.versions import TOOLKIT, version_of
from dataset import Samples
from model.config import TrainConfig
from model.device import Machine
from model.errors import RunError
from model.network.original import PARAMETERS


def provenance(samples: Samples, config: TrainConfig, machine: Machine, ranks: int) -> dict[str, Any]:
    """What a run's config.json says of its training."""
    return {
        "network": "bojarski2016-modified",
        "parameters": PARAMETERS,
        "training": config.as_dict(),
        "machine": machine_settings(machine, ranks),
        "data": {"fingerprint": samples.fingerprint, **samples.metadata},
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """What the training is made with."""
    return {
        "python": platform.python_version(),
        **{name: version_of(name) for name in (TOOLKIT, "torch", "numpy", "pyarrow")},
        "opencv": cv2.__version__,
    }


def machine_settings(machine: Machine, ranks: int) -> dict[str, Any]:
    """What the last bits of the weights depend on besides `TrainConfig`."""
    return {
        "device": machine.device.type,
        "arithmetic": machine.arithmetic,
        "micro_batch": machine.micro_batch,
        "ranks": ranks,
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
    }


def training_of(stored: dict[str, Any], where: str) -> TrainConfig:
    """The settings in a run's config. Raises RunError if they are none; `where` names the file."""
    try:
        return settings_from(TrainConfig, stored.get("training"))
    except ValueError as error:
        raise RunError(f"{where}: its training settings cannot be used ({error})") from None


def data_fingerprint_of(stored: dict[str, Any], where: str) -> str:
    """What identifies the samples that a run was trained on. Raises RunError if its config does not say."""
    try:
        return str(stored["data"]["fingerprint"])
    except (KeyError, TypeError):
        raise RunError(f"{where}: does not say what the run was trained on") from None
