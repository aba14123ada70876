"""The plan of a session's labels: how its steering is smoothed and shifted, by how it was steered.

What somebody with a keyboard meant lies between the presses, and they press after they have seen. A network that
learns each press as it was learns when keys are pressed; the mean over half a second is nearer to what the road
asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from recorder.rows.devices import Device
from recorder.rows.steering_habits import LagFinding, SteeringHabits, SteeringLag

SMOOTH_S: Final = 0.5
"""A press lasts 0.2 to 1 s and pauses are as long: half a second holds one, and is shorter than any bend."""
REACTION_S: Final = 0.2
"""A person's reaction to what the picture shows; with the smoothing above, the error of a network trained on a
keyboard driver fell by 28 % (RMSE, against steering as recorded)."""
RESPONSE_S: Final = 0.1
"""The car turns so long after the steering in recordings of the simulator, in all four that were measured."""
IN_TIME_S: Final = (-0.45, 0.1)
"""Lags that a car explains: none turns before it is steered (0.1 s are rows and rounding), and wheels follow a
command within 0.4 s."""
MAX_LATE_S: Final = 0.5
"""Later than that no recorder notes the steering. What is measured there, or before `IN_TIME_S`, is a fault of the
measurement, and no label goes by it."""
MIN_HZ: Final = 4.0  # fewer rows a second than that leave nothing to smooth in half a second
LATE_DEVICES: Final = frozenset[Device](("keyboard", "mouse"))
"""They are let go between presses and drags, and steer to 0 then. A stick or a finger is held, and steers all the
time. The wheel's steering is recorded as it is in force, so no lag is measured."""


@dataclass(frozen=True)
class LabelPlan:
    """The labels of a session."""

    smooth_s: float
    shift_s: float
    without_crashes: bool  # rows of crashes are not learnt
    why: str  # in words; empty for steering in steps, which is what smoothing is for

    def __str__(self) -> str:
        parts = [f"mean of {self.smooth_s:g} s"] * (self.smooth_s > 0)
        if self.shift_s:
            parts.append(f"{abs(self.shift_s):g} s {'later' if self.shift_s > 0 else 'earlier'}")
        return (", ".join(parts) or "as recorded") + (f" ({self.why})" if self.why else "")


AS_RECORDED: Final = LabelPlan(0.0, 0.0, False, "asked for")
NOT_MEASURED: Final = "lag not measured"
"""Why presses are taken to be in time, as those of all recordings that were measured are."""


def plan_labels(habits: SteeringHabits, finding: LagFinding | None, driven_by: str = "") -> LabelPlan:
    """The plan of a session; `finding` is None where its lag was never measured. `driven_by` names the machine
    that drove it, if one did. The device that a person steered with goes before it: in a drive of both, the
    person's rows are those to learn."""
    if habits.device:
        is_late = habits.device in LATE_DEVICES and (habits.rate_hz or 0.0) >= MIN_HZ
        return LabelPlan(SMOOTH_S * is_late, REACTION_S * is_late, True, habits.device)
    if driven_by:
        return LabelPlan(0.0, 0.0, False, f"driven by {driven_by}")
    if habits.kind not in ("steps", "smooth"):
        return LabelPlan(0.0, 0.0, True, _WHY[habits.kind])
    lag = finding.lag if finding else None
    if lag is not None and lag.correlation < 0:
        return LabelPlan(0.0, 0.0, True, "the pictures turn the other way: is left right?")
    if habits.kind == "smooth":
        return LabelPlan(0.0, 0.0, True, "smooth" + _of_smooth(lag))
    late_s, why = _late(lag) if finding else (0.0, NOT_MEASURED)
    if (habits.rate_hz or 0.0) < MIN_HZ:
        return LabelPlan(0.0, late_s, True, why or "too few rows a second to smooth")
    return LabelPlan(SMOOTH_S, round(REACTION_S + late_s, 2), True, why)


def _of_smooth(lag: SteeringLag | None) -> str:
    """A smooth driver looks ahead, and steers with the bend: at many lags the two go equally well together."""
    if lag is None:
        return ""
    return " and in time" if _is_in_time(lag) else "; its lag is left alone"


def _is_in_time(lag: SteeringLag) -> bool:
    return IN_TIME_S[0] <= lag.lag_s <= IN_TIME_S[1]


def _late(lag: SteeringLag | None) -> tuple[float, str]:
    """How late the steering was recorded, in seconds, and why that is believed, or is not."""
    if lag is None or _is_in_time(lag):
        return 0.0, ""
    if not IN_TIME_S[0] <= lag.lag_s <= MAX_LATE_S:
        return 0.0, "its lag is more than cars have, and not believed"
    if lag.lag_s - (lag.margin_s or 0.0) <= IN_TIME_S[1]:
        return 0.0, "its lag is too unsure to go by"
    late_s = round(lag.lag_s + RESPONSE_S, 2)
    return late_s, f"steering is {late_s:g} s late"


def goes_by_lag(habits: SteeringHabits, driven_by: str) -> bool:
    """True if `plan_labels` goes by the lag, which takes pictures to measure."""
    return not habits.device and not driven_by and habits.kind in ("steps", "smooth")


def machine_of(session: Mapping[str, str], *, has_commands: bool) -> str:
    """The machine that drove a session, by the metadata of its log, and whether a driver's commands are in it: its
    hand is smooth and in time. Empty for people, and if it is unknown."""
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
