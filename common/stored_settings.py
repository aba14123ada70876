"""Settings read from JSON, perhaps somebody else's: names, types and ranges are checked before they are used."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, Final, TypeVar

import msgspec

from common.errors import did_you_mean

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_TOO_LARGE: Final = 1e300

Settings = TypeVar("Settings", bound="DataclassInstance")


def settings_from(kind: type[Settings], stored: Any) -> Settings:
    """The settings of a dataclass that `stored`, parsed JSON, holds; those it leaves out have their defaults.

    For settings that earlier versions did not have, the dataclass may have a class variable `EARLIER`: by name,
    the value that they worked by, where that is not today's default.

    A whole number stays one where a float is wanted: it is printed and written again as it was stored. Raises
    ValueError for names or values that `kind` does not have.
    """
    names = {field.name for field in fields(kind)}
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


def _with_earlier(kind: type[Settings], stored: Any) -> Any:
    earlier = getattr(kind, "EARLIER", {})
    return {**earlier, **stored} if isinstance(stored, dict) else stored
