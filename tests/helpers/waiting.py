"""How the tests wait: for what they are about, never for a time that stands for it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, TypeVar

PATIENCE_S: Final = 300.0
"""For what would otherwise hang for ever. Nothing takes so long, unless it is broken: a machine may be ten times
slower than another, and busy."""

_POLL_S: Final = 0.02

Found = TypeVar("Found")


def wait_until(condition: Callable[[], Found]) -> Found:
    """What `condition` returns, once that is true."""
    end_s = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        assert time.monotonic() < end_s, "it never came to be"
        time.sleep(_POLL_S)
    return found
