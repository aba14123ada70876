"""Settings that were stored as JSON, perhaps by somebody else: their types are checked before they are used."""

from __future__ import annotations

import types
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

Settings = TypeVar("Settings")


def settings_from(kind: type[Settings], stored: object) -> Settings:
    """The settings (a dataclass of numbers, words and tuples of them) that `stored` holds.

    Raises ValueError for names or values that it does not have.
    """
    if not isinstance(stored, Mapping):
        raise ValueError("no settings")
    hints = get_type_hints(kind)
    if unknown := [str(name) for name in stored if name not in hints]:
        raise ValueError(f"unknown settings: {', '.join(sorted(unknown))}")
    values: dict[str, Any] = {}
    for name, value in stored.items():
        values[name] = tuple(value) if isinstance(value, list) else value
        if not _fits(values[name], hints[name]):
            raise ValueError(f"{name} cannot be {value!r:.60}")
    return kind(**values)


def _fits(value: object, hint: Any) -> bool:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _fits(value, arguments[0])
    if origin in (Union, types.UnionType):
        return any(_fits(value, each) for each in arguments)
    if origin is Literal:
        return isinstance(value, str) and value in arguments
    if origin is tuple:  # of any length
        return isinstance(value, tuple) and all(_fits(each, arguments[0]) for each in value)
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return value is None if hint is type(None) else isinstance(value, hint)
