"""The number of frames that a run was trained on, from its config.

A fine-tuned run was also trained on the data of the run that it started from.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from dataset import IndexConfig, Samples
from dataset.frames.frames_table import is_for_training


def count_trained_on(frames: Mapping[str, pa.Table], samples: Samples, config: dict[str, Any]) -> int | None:
    """The number of `frames` that the run with this config was trained on; None if the config does not record it.

    `frames` has a table for each session of `samples`, with the columns row and log_time_ns. Raises LogError for a
    damaged log.
    """
    try:
        started_from = config["init"]["data"] if "init" in config else []
        trainings = [_training_data(data) for data in (config["data"], *started_from)]
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        return None
    count = 0
    for session, part in frames.items():
        is_learnt = np.zeros(len(part), np.bool_)
        for index_config, names in trainings:
            for name in names.get(samples.sources[session].fingerprint, ()):
                is_learnt |= is_for_training(part, samples.logs[session], name, index_config)
        count += int(is_learnt.sum())
    return count


def _training_data(stored: dict[str, Any]) -> tuple[IndexConfig, dict[str, list[str]]]:
    """The settings of the split of a training, and its sessions by the fingerprint of their log. Raises KeyError,
    TypeError, ValueError, AttributeError or OverflowError for invalid data."""
    # Not by `settings_from`, which would refuse the unknown settings of other versions.
    settings = stored["settings"]
    config = IndexConfig(
        block_s=float(settings["block_s"]),
        gap_s=float(settings["gap_s"]),
        validation_share=float(settings["validation_share"]),
        validation=tuple(map(str, settings["validation"])),
        seed=int(settings["seed"]),
        drives="takeovers" if settings.get("drives") == "takeovers" else "all",
    )
    "".join(stored["logs"]).encode()  # raises ValueError for lone surrogates, which JSON may hold
    names: dict[str, list[str]] = {}
    for session, log in stored["logs"].items():
        names.setdefault(str(log["fingerprint"]), []).append(session)
    return config, names
