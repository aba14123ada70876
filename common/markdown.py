"""Text of others in the Markdown that is written here."""

from __future__ import annotations

from typing import Final

from common.errors import printable

_MARKUP: Final = "\\|<>[]`*_!&#~"


def as_markdown(text: str) -> str:
    """Escape somebody else's text: it neither ends a table's cell nor becomes a link, a heading or a tag."""
    return "".join(f"\\{character}" if character in _MARKUP else character for character in printable(text))
