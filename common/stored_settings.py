"""Settings read from JSON, perhaps somebody else's: names, types and ranges are checked before they are used."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, Final, TypeVar

import msgspec

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_TOO_LARGE: Final = 1e300

Settings = TypeVar("Settings", bound="DataclassInstance")


def settings_from(kind: type[Settings], stored: Any) -> Settings:
    """The settings of a dataclass that `stored`, parsed JSON, holds; those it leaves out have their defaults.

    A whole number stays one where a float is wanted: it is printed and written again as it was stored. Raises
    ValueError for names or values that `kind` does not have.
    """
    if isinstance(stored, dict) and (unknown := stored.keys() - {field.name for field in fields(kind)}):
        raise ValueError(f"unknown settings: {', '.join(sorted(map(str, unknown)))}")
    try:
        settings = msgspec.convert(stored, kind)
    except msgspec.ValidationError as error:
        raise ValueError(str(error)) from None
    numbers = {name: value for name, value in stored.items() if isinstance(getattr(settings, name), float)}
    for name, value in numbers.items():
        if not abs(value) < _TOO_LARGE:
            raise ValueError(f"{name} cannot be {value!r:.60}")
    return replace(settings, **numbers)
