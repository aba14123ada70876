"""The status line of a drive that goes on."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

from common.errors import counted
from drive.log.drive_summary import DriveSummary

RATE_S: Final = 1.0
"""The time over which replies a second are counted."""


@dataclass(frozen=True)
class _Sample:
    """The totals of a drive at one call."""

    now_s: float
    replies: int
    bad: int  # of them
    total_ms: float  # of all of them


class LiveStatus:
    """Describes a drive's summary as it grows, with the rates since the call of a second ago."""

    def __init__(self, summary: DriveSummary) -> None:
        self._summary = summary
        self._samples: deque[_Sample] = deque()

    def line(self, now_s: float) -> str:
        """The status at `now_s` of a monotonic clock, for 80 columns; empty before the first telemetry."""
        summary = self._summary
        if not summary.telemetries:
            return ""
        while len(self._samples) > 1 and self._samples[1].now_s <= now_s - RATE_S:
            self._samples.popleft()
        self._samples.append(_Sample(now_s, summary.telemetries, summary.malformed, summary.total_ms))
        first, last = self._samples[0], self._samples[-1]
        replies, bad, passed_s = last.replies - first.replies, last.bad - first.bad, last.now_s - first.now_s
        rate = replies / passed_s if passed_s > 0 else 0.0
        mean_ms = (last.total_ms - first.total_ms) / replies if replies else summary.last_ms
        silent = f"{max(0.0, now_s - summary.last_s):.1f} s ago"
        laps = "" if summary.laps is None else f"{summary.laps:.2f} laps, "
        helped = f"{counted(summary.interventions, 'intervention')}, " if summary.interventions else ""
        if bad and bad == replies:
            return f"{laps}{helped}{rate:.0f} Hz, none of it usable, {silent}"
        speed = "" if summary.speed_mph is None else f"{summary.speed_mph:.1f} mph, "
        replied = f"{rate:.0f} Hz, {f'{bad:,} bad' if bad else f'{mean_ms:.1f} ms'}, {silent}"
        return f"{laps}{helped}{speed}{self._driver()}, {replied}"

    def _driver(self) -> str:
        summary = self._summary
        if summary.is_braked:
            return "braked"
        return {
            "pilot": f"steer {summary.steering:+.2f}",
            "expert": f"expert {summary.steering:+.2f}",
            "human": "a human drives",
        }[summary.driver]
