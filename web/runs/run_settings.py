"""The settings of a run by dotted name, and the differences between runs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from common.errors import printable

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
