"""What the config of a run says, read without PyTorch: its settings, the sessions and the index of its training,
and whether bc-web runs its network: not if it is a user's own code."""

from __future__ import annotations

import contextlib
import hashlib
import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from common import UserError
from common.errors import printable
from common.untrusted import read_bounded
from dataset.parquet_file import read_metadata
from dataset.samples.samples_format import SAMPLES_NAME
from model.runs.network_of_run import is_own_network, network_flag, stored_network
from model.runs.run_files import CONFIG, MAX_CONFIG_BYTES, load_config
from web.errors import WebError
from web.folders.file_versions import version_of

_OF_THE_RUN: Final = ("fingerprint", "content_fingerprint", "targets_fingerprint")
"""Fields of the data in a run's config that the index itself lacks."""
_SHOWN: Final = (
    "network",
    "targets",
    "parameters",
    "init",
    "training",
    "preprocessing",
    "data",
    "machine",
    "versions",
)
_DATA: Final = ("settings", "logs", "fingerprint")  # the settings in `data`; the rest was measured
_MAX_CHARACTERS: Final = 400  # of a value
_DEEPEST: Final = 4


def settings_of(config: Mapping[str, Any]) -> dict[str, str]:
    """The settings of the training and its data in a run's config, by dotted name."""
    config = dict(config)
    data = config.get("data")
    if isinstance(data, dict):
        kept = {name: data[name] for name in _DATA if name in data}
        if isinstance(logs := kept.pop("logs", None), dict):
            kept["sessions"] = ", ".join(sorted(map(str, logs)))
        config["data"] = kept
    if isinstance(init := config.get("init"), dict):
        config["init"] = {name: init.get(name) for name in ("run", "weights_sha256")}
    return dict(_flat({name: config[name] for name in _SHOWN if name in config}, "", 0))


def differing(settings: Sequence[Mapping[str, str]]) -> list[tuple[str, list[str]]]:
    """The settings that differ between runs, with each run's value; "-" if it has none."""
    names = list(dict.fromkeys(name for run in settings for name in run))
    rows = [(name, [run.get(name, "-") for run in settings]) for name in names]
    return [(name, values) for name, values in rows if len(set(values)) > 1]


def _flat(value: Any, name: str, depth: int) -> Iterator[tuple[str, str]]:
    if isinstance(value, dict) and value and depth < _DEEPEST:
        for key, part in value.items():
            yield from _flat(part, f"{name}.{key}" if name else str(key), depth + 1)
        return
    text = value if isinstance(value, str) else json.dumps(value)
    if len(text) > _MAX_CHARACTERS:
        text = f"{text[:_MAX_CHARACTERS]}..."
    yield printable(name.removeprefix("data.settings.")), printable(text)


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


def check_network(run: Path, log: Path) -> None:
    """Raise WebError for a run whose network is a user's own code, with the command that shows it over a log;
    RunError for an unreadable run."""
    config = load_config(run)
    if is_own_network(config):
        words = shlex.join(["bc-play", str(log), "--run", str(run)])
        command = f"{words} {network_flag(stored_network(config, run), run)}"
        raise WebError(
            f"{run}: the network is your own code, which runs only if you name it: use `{command}`", 409
        )


def can_be_run(run: Path) -> bool:
    with contextlib.suppress(UserError):
        return not is_own_network(load_config(run))
    return False
