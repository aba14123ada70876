"""The sessions and the index that runs were trained on, read without PyTorch."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from common.untrusted import read_bounded
from dataset.parquet_file import read_metadata
from dataset.samples.samples_format import SAMPLES_NAME
from model.runs.run_config import MAX_CONFIG_BYTES
from model.runs.run_files import CONFIG
from web.folders.file_versions import version_of

_OF_THE_RUN: Final = ("fingerprint", "content_fingerprint", "targets_fingerprint")
"""Fields of the data in a run's config that the index itself lacks."""


@dataclass(frozen=True)
class RunOrigin:
    """`index` is the checksum of the metadata (settings, logs, balance) that the index had; "" if unknown."""

    sessions: frozenset[str]
    index: str


def origin_of(run: Path) -> RunOrigin:
    """The origin of a run; empty if its config.json cannot be read."""
    config = run / CONFIG
    return _origin(config, version_of(config))


def index_checksum(index: Path) -> str:
    """The checksum of the index's metadata; "" without an index."""
    metadata = read_metadata(index / SAMPLES_NAME)
    return _checksum(metadata) if metadata else ""


@lru_cache(maxsize=4096)
def _origin(config: Path, version: str) -> RunOrigin:
    try:
        data = json.loads(read_bounded(config, MAX_CONFIG_BYTES)).get("data")
    except (OSError, ValueError, RecursionError, AttributeError):
        data = None
    if not isinstance(data, dict):
        return RunOrigin(frozenset(), "")
    logs = data.get("logs")
    sessions = frozenset(logs) if isinstance(logs, dict) else frozenset[str]()
    return RunOrigin(sessions, _checksum({name: data[name] for name in data if name not in _OF_THE_RUN}))


def _checksum(metadata: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(metadata, sort_keys=True).encode()).hexdigest()
