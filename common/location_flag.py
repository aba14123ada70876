"""Flags and arguments that accept a path of this machine or the URL of an object in a store."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeAlias

from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from common.location import Location, Url, local_path, location


def location_spec(metavar: str, place_of: Callable[[str], Location]) -> PrimitiveConstructorSpec[Location]:
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: place_of(_not_empty(words[0])),
        is_instance=lambda value: isinstance(value, Path | Url),
        str_from_instance=lambda value: [str(value)],
    )


def _not_empty(word: str) -> str:
    """Raises ValueError for an empty word, which `pathlib` takes for the working folder."""
    if not word:
        raise ValueError("an empty path")
    return word


def path_flags() -> ConstructorRegistry:
    """A context in which tyro refuses empty paths, and URLs of stores."""
    registry = ConstructorRegistry()

    @registry.primitive_rule
    def path_rule(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Location] | None:
        return location_spec("PATH", local_path) if info.type is Path else None

    return registry


LocationFlag: TypeAlias = Annotated[Location, location_spec("PATH|URL", location)]
