"""The summary of a drive in words: a status line during the drive, and the lines at its end."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from typing import Final

from common.errors import counted
from drive.log.drive_summary import DriveSummary, percentiles_ms

MAX_KINDS: Final = 5  # maximum number of named kinds of unusable messages or pictures
_BRIEF_S: Final = 1.0  # a shorter time without driving is not mentioned

RATE_S: Final = 1.0  # the time over which the replies per second are measured


def summary_lines(summary: DriveSummary) -> list[str]:
    speed_mph = summary.mean_speed_mph
    far = (
        "distance and speed unknown"
        if speed_mph is None
        else f"{_laps(summary)}{summary.distance_m:,.0f} m, {speed_mph:.1f} mph on average"
    )
    lines = [
        f"{counted(summary.frames, 'frame')} in {summary.elapsed_s:,.1f} s{_clock(summary)}: {far}",
        f"autonomy {_autonomy(summary)}, {_interventions(summary)}{_unknown_interventions(summary)}",
    ]
    if summary.wanted_mph is not None:
        lowest_mph, highest_mph = summary.wanted_mph
        lines.append(f"the network wanted {lowest_mph:.1f} to {highest_mph:.1f} mph")
    if summary.frames:
        stages = [
            f"{stage} {'/'.join(f'{ms:.2f}' for ms in percentiles_ms(times_ms))}"
            for stage, times_ms in summary.times_ms.items()
        ]
        lines.append(f"latency p50/p99/max in ms: {', '.join(stages)}{_in_flight(summary)}")
    if summary.pushes:
        times = counted(summary.pushes, "command")
        lines.append(f"the simulator was silent for more than a second: {times} answered no telemetry")
    if summary.unanswered:
        left = counted(summary.unanswered, "telemetry", "telemetries")
        lines.append(f"too many telemetries were in flight: {left} got no answer")
    if summary.bad:
        lines.append(_unusable(summary.bad, "telemetry", "telemetries"))
    if summary.side_problems:
        lines.append(_unusable(summary.side_problems, "picture of a side camera", "pictures of side cameras"))
    if summary.without_number:
        frames = counted(summary.without_number, "frame")
        lines.append(f"the network gave no number for {frames}: the car was braked")
    return lines


def _laps(summary: DriveSummary) -> str:
    return "" if summary.laps is None else f"{summary.laps:.2f} laps, "


def _unusable(problems: Counter[str], singular: str, plural: str) -> str:
    kinds = ", ".join(f"{kind} ({count:,})" for kind, count in problems.most_common(MAX_KINDS))
    others = len(problems) - MAX_KINDS
    more = f", and {counted(others, 'other kind')}" if others > 0 else ""
    return f"{counted(problems.total(), singular, plural)} could not be used: {kinds}{more}"


def _autonomy(summary: DriveSummary) -> str:
    autonomy = summary.autonomy_percent
    if autonomy is None:
        return "unknown, because nothing was driven"
    is_whole = summary.elapsed_s - summary.driven_s < _BRIEF_S
    return f"{autonomy:.1f} %" + ("" if is_whole else f" of the {summary.driven_s:,.1f} s that were driven")


def _interventions(summary: DriveSummary) -> str:
    causes = (
        (summary.manual_stretches, "by a human"),
        (summary.takeovers, "by the expert"),
        (summary.put_back, "by the simulator, which put the car back"),
    )
    listed = ", ".join(f"{number:,} {cause}" for number, cause in causes if number)
    return counted(summary.interventions, "intervention") + (f": {listed}" if listed else "")


def _in_flight(summary: DriveSummary) -> str:
    usual, maximum = summary.usual_in_flight, max(summary.in_flight, default=0)
    if not usual:
        return ""
    at_most = f", at most {maximum}" if maximum > usual else ""
    return f"; {counted(usual, 'telemetry', 'telemetries')} in flight{at_most}"


def _unknown_interventions(summary: DriveSummary) -> str:
    """A remark on frames whose message lacks the simulator's count of interventions."""
    if not summary.frames:
        return ""
    frames = summary.frames - summary.frames_with_interventions
    if frames == summary.frames:
        return " (this simulator does not report when the car leaves the road)"
    return f" (for {counted(frames, 'frame')} unknown whether the car left the road)" if frames else ""


def _clock(summary: DriveSummary) -> str:
    """A remark on the clock of the drive's seconds, if it is not only this computer's."""
    if summary.clock == "both":
        return f" ({summary.simulated_s:,.1f} s by the simulator's clock)"
    return " by the simulator's clock" if summary.clock == "simulator" else ""


@dataclass(frozen=True)
class _Sample:
    now_s: float
    replies: int
    bad: int  # unusable messages among the replies
    total_ms: float  # of all replies


class LiveStatus:
    """Describes the growing summary of a drive, with the rates over the last second."""

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
        laps = _laps(summary)
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
