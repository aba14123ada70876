"""What a process that drives asks of Python and of the system, so that an answer is never late."""

from __future__ import annotations

import gc
import sys
from typing import Final

SWITCH_S: Final = 0.0005
"""How long another thread (the log's) may hold up the one that drives; Python's own 5 ms is five networks long."""


def prepare_process() -> None:
    """To be called once everything is loaded, before the first telemetry."""
    sys.setswitchinterval(SWITCH_S)
    # What is there now stays: no collection has to look through all of PyTorch in the middle of a drive.
    gc.collect()
    gc.freeze()
