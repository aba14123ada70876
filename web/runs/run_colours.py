"""The colour of each run, by its name: it hardly depends on the other runs of a page."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from typing import Final

COLOURS: Final = 8
"""The number of colours in the style sheet (`--series-0` and so on)."""


def run_colours(names: Iterable[str]) -> dict[str, int]:
    """A number from 0 to `COLOURS` - 1 for each run. Up to `COLOURS` runs get different numbers: of two runs with
    the same one, the later by name gets another."""
    colours = dict[str, int]()
    for name in sorted(set(names)):
        first = zlib.crc32(name.encode()) % COLOURS
        numbers = [(first + step) % COLOURS for step in range(COLOURS)]
        colours[name] = next((number for number in numbers if number not in colours.values()), first)
    return colours
