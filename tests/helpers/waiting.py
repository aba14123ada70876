"""How the tests wait: for what they are about, never for a time that stands for it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, TypeVar

PATIENCE_S: Final = 300.0
"""For what would otherwise hang for ever. Nothing takes so long, unless it is broken: a machine may be ten times
slower than another, and busy."""

_POLL_SHARE: Final = 0.1  # of what was waited already: a long wait leaves the processor to others
_POLL_S: Final = (0.005, 0.1)

Found = TypeVar("Found")


def wait_until(condition: Callable[[], Found]) -> Found:
    """What `condition` returns, once that is true."""
    began_s = time.monotonic()
    while not (found := condition()):
        waited_s = time.monotonic() - began_s
        assert waited_s < PATIENCE_S, "it never came to be"
        time.sleep(min(max(waited_s * _POLL_SHARE, _POLL_S[0]), _POLL_S[1]))
    return found
