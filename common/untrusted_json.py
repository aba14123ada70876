"""Parse untrusted JSON into an expected type."""

from __future__ import annotations

from typing import TypeVar

import msgspec

Expected = TypeVar("Expected")


def json_as(text: str | bytes, kind: type[Expected]) -> Expected | None:
    """The parsed JSON as a `kind`; None if it is no valid JSON of this type, or nested too deeply."""
    try:
        return msgspec.json.decode(text, type=kind)
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return None
