"""The kinds of JSON values in plain words, for messages about telemetry."""

from __future__ import annotations

from typing import Final

_KINDS: Final[dict[type, str]] = {
    type(None): "null",
    bool: "true or false",
    int: "a number",
    float: "a number",
    str: "a string",
    bytes: "binary data",
    list: "a list",
    dict: "an object",
}


def json_kind(value: object) -> str:
    """The kind of a value that JSON, or Socket.IO beside it, can hold: "a list"."""
    return _KINDS.get(type(value), "something else")
