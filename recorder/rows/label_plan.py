"""The plan of a session's labels: how its steering is smoothed and shifted, depending on how it was steered.

A person at a keyboard presses keys for moments, and late. A network that learns each press learns when keys are
pressed. The mean over half a second is nearer to the steering that the road needs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from recorder.rows.steering_habits import LagFinding, SteeringHabits, SteeringLag
from recorder.topics import Device

SMOOTH_S: Final = 0.5
"""Presses and pauses last 0.2 to 1 s: half a second holds one, and is shorter than any bend."""
REACTION_S: Final = 0.2
"""A person's reaction time. Together with the smoothing, it lowered the error of a network trained on a keyboard
driver by 28 % (RMSE, compared with steering as recorded)."""
RESPONSE_S: Final = 0.1
"""The time from the steering to the turn of the car, in all four measured recordings of the simulator."""
IN_TIME_S: Final = (-0.45, 0.1)
"""Lags that a car explains. A car does not turn before it is steered (0.1 s are rows and rounding), and wheels
follow a command within 0.4 s."""
MAX_LATE_S: Final = 0.5
"""No recorder is later. A lag above this, or below `IN_TIME_S`, is a measuring error, and labels ignore it."""
MIN_HZ: Final = 4.0  # at fewer rows a second, half a second has nothing to smooth
LATE_DEVICES: Final = frozenset[Device](("keyboard", "mouse"))
"""Between presses and drags, they steer to 0. A stick or a finger steers all the time. For known devices, rows
hold the steering in force, so their lag is not measured."""


@dataclass(frozen=True)
class LabelPlan:
    """The labels of a session."""

    smooth_s: float
    shift_s: float
    without_crashes: bool  # rows of crashes are left out
    why: str  # in words; empty for steering in steps, the usual reason to smooth

    def __str__(self) -> str:
        parts = [f"mean of {self.smooth_s:g} s"] * (self.smooth_s > 0)
        if self.shift_s:
            parts.append(f"{abs(self.shift_s):g} s {'later' if self.shift_s > 0 else 'earlier'}")
        return (", ".join(parts) or "as recorded") + (f" ({self.why})" if self.why else "")


AS_RECORDED: Final = LabelPlan(0.0, 0.0, False, "asked for")
NOT_MEASURED: Final = "lag not measured"
"""Presses then count as in time, as in all recordings that were measured."""


def plan_labels(habits: SteeringHabits, finding: LagFinding | None, driven_by: str = "") -> LabelPlan:
    """The plan of a session. `finding`: None if its lag was never measured. `driven_by`: the machine that drove,
    if one did. A person's device counts first: of a drive by both, the network learns the person's rows."""
    if habits.device:
        is_late = habits.device in LATE_DEVICES and (habits.rate_hz or 0.0) >= MIN_HZ
        return LabelPlan(SMOOTH_S * is_late, REACTION_S * is_late, True, habits.device)
    if driven_by:
        return LabelPlan(0.0, 0.0, False, f"driven by {driven_by}")
    if habits.kind not in ("steps", "smooth"):
        return LabelPlan(0.0, 0.0, True, _WHY[habits.kind])
    lag = finding.lag if finding else None
    if lag is not None and lag.is_mirrored:
        return LabelPlan(0.0, 0.0, True, "the pictures turn the other way: is left right?")
    if habits.kind == "smooth":
        # smooth drivers steer with the bend: steering and turning fit equally well at many lags
        timing = "" if lag is None else " and in time" if _is_in_time(lag) else "; its lag is left alone"
        return LabelPlan(0.0, 0.0, True, f"smooth{timing}")
    late_s, why = _late(lag) if finding else (0.0, NOT_MEASURED)
    if (habits.rate_hz or 0.0) < MIN_HZ:
        return LabelPlan(0.0, late_s, True, why or "too few rows a second to smooth")
    return LabelPlan(SMOOTH_S, round(REACTION_S + late_s, 2), True, why)


def _is_in_time(lag: SteeringLag) -> bool:
    return IN_TIME_S[0] <= lag.lag_s <= IN_TIME_S[1]


def _late(lag: SteeringLag | None) -> tuple[float, str]:
    """The delay of the recorded steering in seconds, and the reason to believe or to ignore it."""
    if lag is None or _is_in_time(lag):
        return 0.0, ""
    if not IN_TIME_S[0] <= lag.lag_s <= MAX_LATE_S:
        return 0.0, "its lag is more than cars have, and not believed"
    if lag.lag_s - (lag.margin_s or 0.0) <= IN_TIME_S[1]:
        return 0.0, "its lag is too unsure to go by"
    late_s = round(lag.lag_s + RESPONSE_S, 2)
    return late_s, f"steering is {late_s:g} s late"


def wrong_timing(lag: SteeringLag) -> str:
    """How late or early steering is, and what corrects it, if it surely is so by more than cars have and plans
    correct; else ""."""
    if abs(lag.lag_s) - (lag.margin_s or 0.0) <= MAX_LATE_S or lag.is_mirrored:
        return ""
    late_s = round(lag.lag_s + RESPONSE_S, 1)
    shift = f"`bc-index --label-shift {late_s:g}` corrects it, in all sessions of the index"
    return f"{abs(late_s):g} s {'late' if late_s > 0 else 'early'}; {shift}"


def goes_by_lag(habits: SteeringHabits, driven_by: str) -> bool:
    """True if `plan_labels` needs the lag, which is measured in pictures."""
    return not habits.device and not driven_by and habits.kind in ("steps", "smooth")


def machine_of(session: Mapping[str, str], *, has_commands: bool) -> str:
    """The machine that drove a session: its steering is smooth and in time. Empty for people, or if unknown.

    `session`: the log's metadata. `has_commands`: the log has commands of a pilot.
    """
    if has_commands:
        return "a network"
    if session.get("source") == "gymnasium":
        return "an expert"  # an environment's actions are some program's
    return "the built-in expert" if session.get("driver") == "expert" else ""


_WHY: Final = {
    "none": "no steering",
    "constant": "constant steering",
    "too short": "too short to tell",
    "other scale": "another scale than -1..1?",
}
