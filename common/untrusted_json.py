"""JSON that somebody else may have written, as the type that is expected."""

from __future__ import annotations

from typing import TypeVar

import msgspec

Expected = TypeVar("Expected")


def json_as(text: str | bytes, kind: type[Expected]) -> Expected | None:
    """The content of JSON as a `kind`; None for anything else, however deep it is nested."""
    try:
        return msgspec.json.decode(text, type=kind)
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return None
