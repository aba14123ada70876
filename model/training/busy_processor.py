"""A warning when other programs want the processor, too.

The threads of a step wait for one another after every layer. Where each of them now and then waits for a processor
as well, two are slower than one: three times, on two cores that two other programs kept busy.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Iterator
from typing import Final

import torch

from common.errors import printable

_MOST: Final = 5 / 3  # how much longer than its thread computes a step may take; on a machine of its own: 1


class BusyProcessorWarning:
    """Measures steps on the processor, and warns once, at once (there may be hours to go), if they are slowed."""

    def __init__(self, *, is_enabled: bool) -> None:
        self._is_enabled = is_enabled
        self._wall_s = self._cpu_s = 0.0  # of the steps since the last check

    @contextlib.contextmanager
    def timed_step(self) -> Iterator[None]:
        wall_s, cpu_s = time.perf_counter(), time.thread_time()
        yield
        self._wall_s += time.perf_counter() - wall_s
        self._cpu_s += time.thread_time() - cpu_s

    def check(self) -> None:
        """Warn if the steps since the last check were slowed."""
        if self._is_enabled and (notice := busy_notice(torch.get_num_threads(), self._wall_s, self._cpu_s)):
            logging.getLogger(__name__).warning("%s", printable(notice))
            self._is_enabled = False
        self._wall_s = self._cpu_s = 0.0


def busy_notice(threads: int, wall_s: float, cpu_s: float) -> str:
    """The warning about steps that took `wall_s`, in which the thread that asked for them computed for `cpu_s`;
    empty if that is as it should be, or if there is only one thread."""
    if threads == 1 or wall_s <= _MOST * cpu_s:
        return ""
    slower = f"{min(wall_s / cpu_s, 99):.1f}" if cpu_s > 0 else "many"
    return (
        f"the processor is busy with other programs: a step takes {slower} times as long as it computes, and"
        f" {threads} threads wait for one another; --threads {threads // 2} may be faster, also to --resume with"
    )
