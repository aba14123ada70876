"""The summary of a drive as lines for people."""

from __future__ import annotations

from typing import Final

from common.errors import counted
from drive.log.drive_summary import DriveSummary

MAX_KINDS: Final = 5
"""The kinds of bad telemetry that are named."""
_BRIEF_S: Final = 1.0
"""A shorter time that was not driven goes without mention."""


def summary_lines(summary: DriveSummary) -> list[str]:
    """The lines that are printed at the end of a drive."""
    laps = "" if summary.laps is None else f"{summary.laps:.2f} laps, "
    speed_mph = summary.mean_speed_mph
    far = (
        "distance and speed unknown"
        if speed_mph is None
        else f"{laps}{summary.distance_m:,.0f} m, {speed_mph:.1f} mph on average"
    )
    lines = [
        f"{counted(summary.frames, 'frame')} in {summary.elapsed_s:,.1f} s{_clock(summary)}: {far}",
        f"autonomy {_autonomy(summary)}, {_interventions(summary)}{_unknown_interventions(summary)}",
    ]
    if summary.wanted_mph is not None:
        least, most = summary.wanted_mph
        lines.append(f"the network wanted {least:.1f} to {most:.1f} mph")
    if summary.frames:
        stages = (f"{stage} {latency}" for stage, latency in summary.latency.items())
        lines.append(f"latency p50/p99/max in ms: {', '.join(stages)}{_in_flight(summary)}")
    if summary.pushes:
        times = counted(summary.pushes, "command")
        left = counted(summary.unanswered, "telemetry", "telemetries")
        lines.append(
            f"the simulator was silent for more than a second: {times} answered no telemetry, {left} got no answer"
        )
    if summary.bad:
        unusable = counted(summary.malformed, "telemetry", "telemetries")
        kinds = ", ".join(f"{kind} ({count:,})" for kind, count in summary.bad.most_common(MAX_KINDS))
        others = len(summary.bad) - MAX_KINDS
        more = f", and {counted(others, 'other kind')}" if others > 0 else ""
        lines.append(f"{unusable} could not be used: {kinds}{more}")
    if summary.side_problems:
        unusable = counted(summary.side_problems.total(), "picture of a side camera", "pictures of side cameras")
        kinds = ", ".join(f"{kind} ({count:,})" for kind, count in summary.side_problems.most_common(MAX_KINDS))
        lines.append(f"{unusable} could not be used: {kinds}")
    if summary.without_number:
        frames = counted(summary.without_number, "frame")
        lines.append(f"the network gave no number for {frames}: the car was braked")
    return lines


def _autonomy(summary: DriveSummary) -> str:
    autonomy = summary.autonomy_percent
    if autonomy is None:
        return "unknown, for nothing was driven"
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
    usual, most = summary.usual_in_flight, max(summary.in_flight, default=0)
    if not usual:
        return ""
    at_most = f", at most {most}" if most > usual else ""
    return f"; {counted(usual, 'telemetry', 'telemetries')} in flight{at_most}"


def _unknown_interventions(summary: DriveSummary) -> str:
    """A remark on frames without the simulator's interventions in their telemetry."""
    if not summary.frames:
        return ""
    frames = summary.frames - summary.frames_with_interventions
    if frames == summary.frames:
        return " (this simulator does not report when the car leaves the road)"
    return f" (for {counted(frames, 'frame')} unknown whether the car left the road)" if frames else ""


def _clock(summary: DriveSummary) -> str:
    """A remark on the clock of the drive's seconds, where that is not this computer's alone."""
    if summary.clock == "both":
        return f" ({summary.simulated_s:,.1f} s by the simulator's clock)"
    return " by the simulator's clock" if summary.clock == "simulator" else ""
