"""The settings of a process that drives, so that threads and garbage collection do not delay it."""

from __future__ import annotations

import gc
import sys
from typing import Final

SWITCH_S: Final = 0.0005
"""The longest that another thread (the log's) may delay the one that drives; Python's 5 ms are five
predictions."""


def prepare_process() -> None:
    """Prepare this process; to be called once everything is loaded, before the first telemetry."""
    sys.setswitchinterval(SWITCH_S)
    # What is loaded stays: no collection has to go through all of PyTorch in the middle of a drive.
    gc.collect()
    gc.freeze()
