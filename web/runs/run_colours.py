"""The colour of each run: it belongs to the run's name, whatever else is shown and in whichever order."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from typing import Final

COLOURS: Final = 8
"""So many the style sheet has (`--series-0` and so on)."""


def run_colours(names: Iterable[str]) -> dict[str, int]:
    """Numbers from 0 to `COLOURS` - 1. Runs that are shown together differ, as far as there are colours: the later
    one by name gives way."""
    colours = dict[str, int]()
    for name in sorted(set(names)):
        first = zlib.crc32(name.encode()) % COLOURS
        numbers = [(first + step) % COLOURS for step in range(COLOURS)]
        colours[name] = next((number for number in numbers if number not in colours.values()), first)
    return colours
