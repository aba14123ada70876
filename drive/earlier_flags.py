"""Flags by the names of the version before: they are understood, with a hint at their new name."""

from __future__ import annotations

import sys
from collections.abc import Mapping

from common.output import print_message


def understand_earlier(prog: str, renamed: Mapping[str, str]) -> None:
    """Replace earlier names of flags in `sys.argv`."""
    for number, word in enumerate(sys.argv):
        name, *value = word.split("=", 1)
        if name in renamed:
            print_message(f"{prog}: {name} is called {renamed[name]} now; the next version knows only that")
            sys.argv[number] = "=".join([renamed[name], *value])
