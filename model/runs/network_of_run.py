"""The network of a run and the picture that it sees, from its config.json. Code that the config names runs only if
the user names it, too."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import msgspec

from common.errors import printable
from dataset.picture_spec import PictureSpec
from dataset.prediction_targets import STEERING_ONLY, TargetName, check_targets
from model.config import Light
from model.errors import RunError
from model.network.names import check_network_name, is_file, is_own
from model.network.own_code import named_code, named_otherwise

if TYPE_CHECKING:
    from model.network.choice import NetworkChoice  # loads PyTorch

NETWORK_FILE: Final = "network.py"
"""A run's copy of the file that defines its network."""

_EARLIER: Final = "bojarski2016-modified"
"""The name of the original network in earlier versions, which had only this one."""


class StoredNetwork(msgspec.Struct, frozen=True):
    """The network of a run, as its config.json stores it."""

    name: str = "original"
    arguments: dict[str, Any] = {}
    file_sha256: str = ""


class _StoredSettings(msgspec.Struct, frozen=True):
    """The training settings of a run that concern its network, as its config.json stores them."""

    network_args: tuple[str, ...] = ()
    target_weights: tuple[Annotated[float, msgspec.Meta(ge=0)], ...] = ()


def stored_network(config: dict[str, Any], folder: Path) -> StoredNetwork:
    """The network in the config.json of the run in `folder`. Raises RunError for an unknown network."""
    stored = config.get("network", _EARLIER)
    if stored == _EARLIER:
        return StoredNetwork()
    try:
        network = msgspec.convert(stored, StoredNetwork)
        check_network_name(network.name)
    except ValueError as error:
        raise RunError(f"{folder}: its network is unknown ({printable(str(error))}); train it again") from None
    return network


def stored_targets(config: dict[str, Any], folder: Path) -> tuple[TargetName, ...]:
    """The targets that the network of the run in `folder` answers. Raises RunError for unknown ones."""
    try:
        names = msgspec.convert(config.get("targets", STEERING_ONLY), tuple[TargetName, ...])
        check_targets(names)
    except ValueError as error:
        raise RunError(f"{folder}: its targets are unknown ({printable(str(error))}); train it again") from None
    return names


def picture_of(config: dict[str, Any], folder: Path) -> PictureSpec:
    """The picture that the run in `folder` sees. Raises RunError for a preprocessing other than this toolkit's."""
    try:
        return PictureSpec.from_description(config.get("preprocessing"))
    except ValueError as error:
        raise RunError(
            f"{folder}: trained with another preprocessing than this toolkit's ({printable(str(error))}); train it"
            " again"
        ) from None


def choice_of(config: dict[str, Any], folder: Path) -> NetworkChoice:
    """The network of the run in `folder`, ready to build.

    Raises RunError for a user's own network if this process did not load it (`load_code`), or if it has changed.
    """
    from model.network.choice import NetworkChoice, built_in

    stored, outputs = stored_network(config, folder), len(stored_targets(config, folder))
    if not is_own(stored.name):
        return replace(built_in(stored.name, stored.arguments), outputs=outputs)
    code = named_code(stored.name, stored.file_sha256)
    if code is not None:
        return NetworkChoice(stored.name, stored.arguments, code.make, code, outputs)
    name = printable(stored.name)
    if (other := named_otherwise(stored.name)) is not None and is_file(stored.name):
        raise RunError(
            f"{printable(other.name)}: not the file that {folder} was trained with (its SHA-256 is another); give"
            f" {network_flag(stored, folder)}"
        )
    raise RunError(
        f"{folder}: its network is {name}, code that runs only if you name it: {network_flag(stored, folder)}"
    )


def network_flag(stored: StoredNetwork, folder: Path) -> str:
    """The flag that names the network of a run; for a file, the run's copy if it has one."""
    name = stored.name
    if is_own(name) and is_file(name) and (folder / NETWORK_FILE).is_file():
        name = f"{folder / NETWORK_FILE}:{name.rpartition(':')[2]}"
    return f"--network {shlex.quote(name)}"


def own_network_flag(config: Mapping[str, Any], folder: Path) -> str:
    """The flag after a run's name that names a user's own network, whose code never runs unasked; empty for other
    networks, and for unknown ones."""
    try:
        stored = stored_network(dict(config), folder)
    except RunError:
        return ""
    return f" {printable(network_flag(stored, folder))}" if is_own(stored.name) else ""


def light_of(config: dict[str, Any], folder: Path) -> Light:
    """The brightness and contrast in which the network of the run in `folder` sees pictures."""
    network = stored_network(config, folder)
    is_standardized = not is_own(network.name) and network.arguments.get("standardized")
    return "standardized" if is_standardized else "as-seen"


def is_own_network(config: dict[str, Any]) -> bool:
    """True if a run's config.json names a user's own code as its network."""
    stored = config.get("network")
    name = stored.get("name") if isinstance(stored, dict) else None
    return isinstance(name, str) and is_own(name)


def network_settings(config: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Settings of a `TrainConfig` for another training of the same network and targets. Raises RunError for
    settings that cannot be used."""
    network, picture = stored_network(config, folder), picture_of(config, folder)
    try:
        stored = msgspec.convert(config.get("training", {}), _StoredSettings)
    except ValueError as error:
        raise RunError(f"{folder}: its training settings cannot be used ({printable(str(error))})") from None
    return {
        "network": network.name,
        "network_args": stored.network_args,
        "targets": stored_targets(config, folder),
        "target_weights": stored.target_weights,
        "picture_px": (picture.width_px, picture.height_px),
        "crop_rows": (picture.crop_top, picture.crop_bottom),
        "channels": picture.channels,
        "light": light_of(config, folder),
    }
