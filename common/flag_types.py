"""Types of flags without typeguard, which takes 50 ms to load: tyro asks it even about flags without a default.

The functions are private to tyro. Where they are missing, typeguard is loaded.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from types import UnionType
from typing import Any, get_args, get_origin


@contextlib.contextmanager
def quick_types() -> Iterator[None]:
    """Answer tyro here where no default is given, and for unions and tuples of simple types."""
    try:
        from tyro import _resolver
        from tyro._resolver import is_instance
        from tyro._singleton import is_sentinel
    except ImportError:
        yield
        return

    def answer(typ: Any, value: Any) -> bool:
        if is_sentinel(value):
            return False
        if isinstance(typ, UnionType):
            return any(answer(member, value) for member in get_args(typ))
        if get_origin(typ) is tuple and not isinstance(value, tuple):
            return False
        if get_origin(typ) is tuple and get_args(typ)[1:] == (Ellipsis,):
            return all(answer(get_args(typ)[0], item) for item in value)
        return is_instance(typ, value)

    _resolver.is_instance = answer
    try:
        yield
    finally:
        _resolver.is_instance = is_instance
