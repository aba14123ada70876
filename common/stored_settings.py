"""Settings read from JSON or TOML, perhaps somebody else's: names, types and ranges are checked before they are
used."""

from __future__ import annotations

import tomllib
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import msgspec

from common.errors import did_you_mean
from common.untrusted import read_bounded

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_TOO_LARGE: Final = 1e300
_MAX_TOML_BYTES: Final = 1 << 20

Settings = TypeVar("Settings", bound="DataclassInstance")


def settings_from(kind: type[Settings], stored: Any) -> Settings:
    """The settings of a dataclass that `stored`, parsed JSON, holds; those it leaves out have their defaults.

    For settings that earlier versions did not have, the dataclass may have a class variable `EARLIER`: by name,
    the value that they worked by, where that is not today's default. For those that only earlier versions had, it
    may have `EARLIER_ONLY`: by name, the only value that is ignored, or `...` for any.

    A whole number stays one where a float is wanted: it is printed and written again as it was stored. Raises
    ValueError for names or values that `kind` does not have.
    """
    names = {field.name for field in fields(kind)}
    if isinstance(stored, dict):
        removed = getattr(kind, "EARLIER_ONLY", {})
        stored = {
            name: value
            for name, value in stored.items()
            if name not in removed or (removed[name] is not ... and removed[name] != value)
        }
    if isinstance(stored, dict) and (unknown := sorted(map(str, stored.keys() - names))):
        meant = did_you_mean(unknown[0], names)
        raise ValueError(f"unknown settings: {', '.join(unknown)}{f'; {meant}' if meant else ''}")
    try:
        settings = msgspec.convert(_with_earlier(kind, stored), kind)
    except msgspec.ValidationError as error:
        raise ValueError(str(error)) from None
    numbers = {name: value for name, value in stored.items() if isinstance(getattr(settings, name), float)}
    for name, value in numbers.items():
        if not abs(value) < _TOO_LARGE:
            raise ValueError(f"{name} cannot be {value!r:.60}")
    return replace(settings, **numbers)


def read_toml(path: Path | str) -> dict[str, Any]:
    """The content of a TOML file. Raises OSError where it cannot be read or is larger than 1 MB, ValueError for
    anything else than TOML, however deep it is nested."""
    try:
        return tomllib.loads(read_bounded(path, _MAX_TOML_BYTES).decode())
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _with_earlier(kind: type[Settings], stored: Any) -> Any:
    earlier = getattr(kind, "EARLIER", {})
    return {**earlier, **stored} if isinstance(stored, dict) else stored
