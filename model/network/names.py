"""Names of networks: built-in ones, `FILE.py:CLASS`, `package.module:CLASS`. Imports no network."""

from __future__ import annotations

import re
from typing import Final

from common.errors import did_you_mean, printable

BUILT_IN: Final = {
    "original": "model.network.pilotnet:SteeringNetwork",
    "pilotnet": "model.network.pilotnet:PilotNet",
    "small": "model.network.pilotnet:SmallNetwork",
    "resnet18": "model.network.resnet18:ResNet18",
}

_MODULE: Final = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*")
_CLASS: Final = re.compile(r"[^\W\d]\w*")


def check_network_name(name: str) -> None:
    """Raise ValueError if `name` does not have the form of a network's name. The network need not exist."""
    if name in BUILT_IN:
        return
    place, _, kind = name.rpartition(":")
    if not _CLASS.fullmatch(kind) or not (is_file(name) or _MODULE.fullmatch(place)):
        meant = did_you_mean(name, list(BUILT_IN))
        expected = f"{', '.join(BUILT_IN)}, FILE.py:CLASS or package.module:CLASS"
        raise ValueError(f"--network {printable(name)}: expected {expected}{f'; {meant}' if meant else ''}")


def is_own(name: str) -> bool:
    """True for a user's own network, False for a built-in one."""
    return name not in BUILT_IN


def is_file(name: str) -> bool:
    return name.rpartition(":")[0].endswith(".py")
