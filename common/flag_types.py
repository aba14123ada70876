"""Check the types of flags without typeguard, which takes 50 ms to load: tyro uses it even for flags without a
default.

This replaces private functions of tyro. If they are missing, tyro loads typeguard.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from types import UnionType
from typing import Any, get_args, get_origin


@contextlib.contextmanager
def quick_types() -> Iterator[None]:
    """Replace tyro's type check in the block, for flags without a default, and for unions and tuples of simple
    types."""
    try:
        from tyro import _resolver
        from tyro._resolver import is_instance
        from tyro._singleton import is_sentinel
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

    _resolver.is_instance = has_type
    try:
        yield
    finally:
        _resolver.is_instance = is_instance
