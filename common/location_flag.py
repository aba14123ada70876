"""Flags and arguments that accept a path of this machine or the URL of an object in a store."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeAlias

from tyro.constructors import PrimitiveConstructorSpec

from common.location import Location, Url, location


def location_spec(metavar: str, place_of: Callable[[str], Location]) -> PrimitiveConstructorSpec[Location]:
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: place_of(words[0]),
        is_instance=lambda value: isinstance(value, Path | Url),
        str_from_instance=lambda value: [str(value)],
    )


LocationFlag: TypeAlias = Annotated[Location, location_spec("PATH|URL", location)]
