"""Names of sessions: which are valid, and the one that a recording gets."""

from __future__ import annotations

import os
import re
import shlex
from pathlib import Path
from typing import Final

from common.errors import UsageError, printable

_NOT_IN_FILE_NAMES: Final = '/\\:*?"<>|'  # of one of the systems
_ENDING: Final = re.compile(r"(\.(zip|mcap|csv|db3))+$", re.IGNORECASE)
_MAX_BYTES: Final = 120
_UDACITY_CSV: Final = "driving_log.csv"  # the same in every recording


def check_name(name: str) -> None:
    """Raise UsageError for a name that a session cannot have."""
    if not name or name.startswith((".", "-")) or set(name) & set(_NOT_IN_FILE_NAMES) or printable(name) != name:
        raise UsageError(f"{name!r}: not a name for a session; give a plain one, such as lake")
    if name.endswith(".mcap"):
        raise UsageError(f"{name}: give the name without its ending: {shlex.quote(name.removesuffix('.mcap'))}")


def name_of_recording(source: Path) -> str:
    """The name of a recording's session: that of its folder, or of its file."""
    path = Path(os.path.abspath(source))  # noqa: PTH100  (Path.resolve would follow a link to another name)
    return plain_name(path.parent.name if path.name == _UDACITY_CSV else path.name)


def plain_name(name: str) -> str:
    """A plain name for a folder or session, made from a file's name in any language: it needs no quotes."""
    plain = "".join(
        letter if (letter.isprintable() if letter > "\x7f" else letter.isalnum() or letter in "_.-") else " "
        for letter in _ENDING.sub("", name)
    )
    words = "-".join(plain.split())
    return words.encode()[:_MAX_BYTES].decode(errors="ignore").strip("-.") or "recording"
