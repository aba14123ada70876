"""The number of frames that a run was trained on, as far as its config records it.

A fine-tuned run was also trained on the data of the run that it started from.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from dataset import IndexConfig, Samples
from dataset.index.training_frames import is_for_training


@dataclass(frozen=True)
class _TrainingData:
    """The data of a training."""

    logs: tuple[tuple[str, str], ...]  # session and fingerprint
    config: IndexConfig  # the settings that the split depends on


def count_trained_on(frames: Mapping[str, pa.Table], samples: Samples, config: dict[str, Any]) -> int | None:
    """The number of frames that the run with this config was trained on; None where the config does not record it.

    `frames` are those of each session of `samples`, with the columns row and log_time_ns. Raises LogError for a
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
        for training in trainings:
            for name, fingerprint in training.logs:
                if fingerprint == samples.sources[session].fingerprint:
                    is_learnt |= is_for_training(part, samples.logs[session], name, training.config)
        count += int(is_learnt.sum())
    return count


def by_session(frames: pa.Table) -> dict[str, pa.Table]:
    """The frames of each session."""
    session = frames["session"].combine_chunks().dictionary_encode()
    number, names = session.indices.to_numpy(), session.dictionary.to_pylist()
    ends = np.cumsum(np.bincount(number, minlength=len(names)))
    parts = np.split(np.argsort(number, kind="stable"), ends[:-1])
    return {name: frames.take(pa.array(part)) for name, part in sorted(zip(names, parts, strict=True))}


def _training_data(stored: dict[str, Any]) -> _TrainingData:
    """Raises KeyError, TypeError, ValueError, AttributeError or OverflowError if `stored` is none."""
    # Not by `settings_from`: values of other types, and settings of other versions, do not hide what was learnt.
    settings = stored["settings"]
    config = IndexConfig(
        block_s=float(settings["block_s"]),
        gap_s=float(settings["gap_s"]),
        validation_share=float(settings["validation_share"]),
        validation=tuple(map(str, settings["validation"])),
        seed=int(settings["seed"]),
        drives="takeovers" if settings.get("drives") == "takeovers" else "all",
    )
    logs = tuple((str(session), str(log["fingerprint"])) for session, log in stored["logs"].items())
    for session, _ in logs:
        session.encode()  # JSON may hold halves of characters, which no name of a log has
    return _TrainingData(logs, config)
