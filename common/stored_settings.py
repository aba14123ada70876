"""Settings read from untrusted JSON or TOML: names, types and ranges are checked."""

from __future__ import annotations

import tomllib
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import msgspec

from common.errors import did_you_mean, printable
from common.untrusted import read_bounded

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_TOO_LARGE: Final = 1e300
_MAX_TOML_BYTES: Final = 1 << 20

Settings = TypeVar("Settings", bound="DataclassInstance")


def settings_from(kind: type[Settings], stored: Any) -> Settings:
    """Convert `stored`, parsed JSON, to the dataclass `kind`. Missing settings get their defaults.

    Two class variables of `kind` handle settings of earlier versions. `EARLIER` maps a setting that they lacked to
    the value that they used, if this is not today's default. `EARLIER_ONLY` maps a removed setting to the value
    that is ignored, or to `...` if any value is ignored.

    An integer stays an integer in a float field, so that it is printed and written as it was stored. Raises
    ValueError for unknown names and invalid values.
    """
    if isinstance(stored, dict):
        removed = getattr(kind, "EARLIER_ONLY", {})
        stored = {
            name: value
            for name, value in stored.items()
            if name not in removed or (removed[name] is not ... and removed[name] != value)
        }
        names = {field.name for field in fields(kind)}
        if unknown := sorted(map(str, stored.keys() - names)):
            raise ValueError(f"unknown settings: {', '.join(unknown)}{did_you_mean(unknown[0], names, '; ')}")
    try:
        earlier = getattr(kind, "EARLIER", {})
        settings = msgspec.convert({**earlier, **stored} if isinstance(stored, dict) else stored, kind)
    except msgspec.ValidationError as error:
        raise ValueError(str(error)) from None
    numbers = {name: value for name, value in stored.items() if isinstance(getattr(settings, name), float)}
    for name, value in numbers.items():
        if not abs(value) < _TOO_LARGE:
            raise ValueError(f"{name} cannot be {value!r:.60}")
    return replace(settings, **numbers)


def settings_of_file(kind: type[Settings], path: Path | str) -> Settings:
    """Convert a TOML file of at most 1 MB to the dataclass `kind`, as `settings_from` does. Raises ValueError,
    with the reason in one line, also if the file cannot be read."""
    try:
        return settings_from(kind, tomllib.loads(read_bounded(path, _MAX_TOML_BYTES).decode()))
    except FileNotFoundError:
        reason = "no such file"
    except RecursionError:
        reason = "nested too deeply"
    except (OSError, ValueError) as error:
        reason = printable(" ".join(str(error).split()))
    raise ValueError(reason)
