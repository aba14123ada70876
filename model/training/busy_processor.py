"""Noticing that other programs want the processor too.

The threads of a step wait for one another after every layer. Where each of them now and then waits for a processor
as well, two are slower than one: three times, on two cores that two other programs kept busy.
"""

from __future__ import annotations

from typing import Final

_MOST: Final = 5 / 3  # how much longer than its thread computes a step may take; on a machine of its own: 1


def busy_notice(threads: int, wall_s: float, cpu_s: float) -> str:
    """What to say of steps that took `wall_s`, in which the thread that asked for them computed for `cpu_s`; empty
    if that is as it should be, or if there is only one thread."""
    if threads == 1 or wall_s <= _MOST * cpu_s:
        return ""
    slower = f"{min(wall_s / cpu_s, 99):.1f}" if cpu_s > 0 else "many"
    return (
        f"the processor is busy with other programs: a step takes {slower} times as long as it computes, and"
        f" {threads} threads wait for one another; --threads {threads // 2} may be faster, also to --resume with"
    )
