"""The number of frames that a run was trained on, as far as its config says.

A fine-tuned run was also trained on the data of the run that it started from.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa

from common.stored_settings import settings_from
from dataset import IndexConfig, Samples
from dataset.index.training_frames import is_for_training
from model.runs.provenance import StoredData

_SPLIT_SETTINGS: Final = ("block_s", "gap_s", "validation_share", "validation", "seed")


def count_trained_on(frames: Mapping[str, pa.Table], samples: Samples, config: dict[str, Any]) -> int | None:
    """The number of frames that the run with this config was trained on; None where that does not say.

    `frames` are those of each session of `samples`, with the columns row and log_time_ns. Raises LogError for a
    damaged log.
    """
    try:
        started_from = config["init"]["data"] if "init" in config else []
        trainings = msgspec.convert([config["data"], *started_from], list[StoredData])
        splits = [_split_settings(data) for data in trainings]
        "".join(name for data in trainings for name in data.logs).encode()  # no log is named by half a character
    except (KeyError, TypeError, ValueError):
        return None
    count = 0
    for session, part in frames.items():
        is_learnt = np.zeros(len(part), np.bool_)
        for data, split in zip(trainings, splits, strict=True):
            for name, log in data.logs.items():
                if log.fingerprint == samples.sources[session][1]:
                    is_learnt |= is_for_training(part, samples.logs[session], name, split)
        count += int(is_learnt.sum())
    return count


def by_session(frames: pa.Table) -> dict[str, pa.Table]:
    """The frames of each session."""
    session = frames["session"].combine_chunks().dictionary_encode()
    number, names = session.indices.to_numpy(), session.dictionary.to_pylist()
    ends = np.cumsum(np.bincount(number, minlength=len(names)))
    parts = np.split(np.argsort(number, kind="stable"), ends[:-1])
    return {name: frames.take(pa.array(part)) for name, part in sorted(zip(names, parts, strict=True))}


def _split_settings(data: StoredData) -> IndexConfig:
    """The settings that the split of an index depends on. Raises KeyError or ValueError if some are missing."""
    split = {name: data.settings[name] for name in _SPLIT_SETTINGS}
    return settings_from(IndexConfig, {**split, "drives": data.settings.get("drives", "all")})
