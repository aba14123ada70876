"""Check the types of flags without typeguard, which takes 50 ms to load: tyro uses it even for flags without a
default. Name the types without None: "FLOAT" for `float | None`, for which tyro writes "{None}|FLOAT".

This replaces private functions of tyro. If they are missing, tyro loads typeguard, and names None.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from types import UnionType
from typing import Any, get_args, get_origin


@contextlib.contextmanager
def quick_types() -> Iterator[None]:
    """Replace tyro's type check in the block, for flags without a default, and for unions and tuples of simple
    types; and its names of unions."""
    try:
        from tyro import _resolver, _strings
        from tyro._resolver import is_instance
        from tyro._singleton import is_sentinel
        from tyro._strings import join_union_metavars
    except ImportError:
        yield
        return

    def has_type(typ: Any, value: Any) -> bool:
        if is_sentinel(value):
            return False
        if isinstance(typ, UnionType):
            return any(has_type(member, value) for member in get_args(typ))
        if get_origin(typ) is tuple and not isinstance(value, tuple):
            return False
        if get_origin(typ) is tuple and get_args(typ)[1:] == (Ellipsis,):
            return all(has_type(get_args(typ)[0], item) for item in value)
        return is_instance(typ, value)

    def name_of_union(metavars: Iterable[str]) -> str:
        shown = [name for name in metavars if name != "{None}"]
        return join_union_metavars(shown) if len(shown) > 1 else shown[0]

    _resolver.is_instance, _strings.join_union_metavars = has_type, name_of_union
    try:
        yield
    finally:
        _resolver.is_instance, _strings.join_union_metavars = is_instance, join_union_metavars
