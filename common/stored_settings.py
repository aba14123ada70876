"""Settings read from JSON, perhaps somebody else's: names, types and ranges are checked before they are used."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, TypeVar

import msgspec

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Settings = TypeVar("Settings", bound="DataclassInstance")


def settings_from(kind: type[Settings], stored: object) -> Settings:
    """The settings of a dataclass that `stored`, parsed JSON, holds; those it leaves out have their defaults.

    Raises ValueError for names or values that `kind` does not have.
    """
    if isinstance(stored, dict) and (unknown := stored.keys() - {field.name for field in fields(kind)}):
        raise ValueError(f"unknown settings: {', '.join(sorted(map(str, unknown)))}")
    try:
        return msgspec.convert(stored, kind)
    except msgspec.ValidationError as error:
        raise ValueError(str(error)) from None
