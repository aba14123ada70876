"""Which runs were trained on what: on the index as it is now, on a session, and which of them drove."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dataset.parquet_file import read_metadata
from dataset.samples.samples_format import SAMPLES_NAME
from web.data.project_folders import RUN_CONFIG


class TrainedOn:
    """What the config.json of each run says of its data; read without PyTorch."""

    def __init__(self, index: Path) -> None:
        self._index = read_metadata(index / SAMPLES_NAME)

    def is_index(self, run: Path) -> bool:
        """Whether the run was trained on the index as it is now: the same settings, logs and balance."""
        data = _data(run)
        return bool(self._index) and all(data.get(name) == value for name, value in (self._index or {}).items())


def learnt_from(run: Path, session: str) -> bool:
    """Whether that session was in what the run was trained on."""
    logs = _data(run).get("logs")
    return isinstance(logs, dict) and session in logs


def _data(run: Path) -> Mapping[str, Any]:
    """Empty where it cannot be read: the list of runs says why."""
    try:
        data = json.loads((run / RUN_CONFIG).read_bytes()).get("data")
    except (OSError, ValueError, RecursionError, AttributeError):
        return {}
    return data if isinstance(data, dict) else {}
