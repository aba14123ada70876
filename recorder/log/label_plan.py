"""The plan of a session's labels: how its steering is smoothed and shifted, by how it was steered.

What somebody with a keyboard meant lies between the presses, and they press after they have seen. A network that
learns each press as it was learns when keys are pressed; the mean over half a second is nearer to what the road
asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from recorder.log.steering_habits import SteeringHabits, SteeringLag

SMOOTH_S: Final = 0.5
"""A press lasts 0.2 to 1 s and pauses are as long: half a second holds one, and is shorter than any bend."""
REACTION_S: Final = 0.2
"""A person's reaction to what the picture shows; with the smoothing above, the error of a network trained on a
keyboard driver fell by 28 % (RMSE, against steering as recorded)."""
RESPONSE_S: Final = 0.1
"""The car turns so long after the steering in recordings of the simulator, in all four that were measured."""
IN_TIME_S: Final = (-0.45, 0.1)
"""Lags that a car explains: none turns before it is steered (0.1 s are rows and rounding), and wheels follow a
command within 0.4 s. Outside of it, the record is late or early."""
LEAST_HZ: Final = 4.0
"""Fewer rows a second than that leave nothing to smooth in half a second."""


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


def plan_labels(habits: SteeringHabits, lag: SteeringLag | None, driven_by: str = "") -> LabelPlan:
    """The plan of a session; `driven_by` names the machine that drove it, if one did."""
    if driven_by:
        return LabelPlan(0.0, 0.0, False, f"driven by {driven_by}")
    if habits.kind not in ("steps", "smooth"):
        return LabelPlan(0.0, 0.0, True, _WHY[habits.kind])
    if lag is not None and lag.correlation < 0:
        return LabelPlan(0.0, 0.0, True, "the pictures turn the other way: is left right?")
    late_s = 0.0
    if lag is not None and not IN_TIME_S[0] <= lag.lag_s <= IN_TIME_S[1]:
        late_s = round(lag.lag_s + RESPONSE_S, 2)
    why = f"steering is {abs(late_s):g} s {'late' if late_s > 0 else 'early'}"
    if habits.kind == "smooth":
        in_time = "smooth" if lag is None else "smooth and in time"
        return LabelPlan(0.0, late_s, True, why if late_s else in_time)
    if (habits.rate_hz or 0.0) < LEAST_HZ:
        return LabelPlan(0.0, late_s, True, why if late_s else "too few rows a second to smooth")
    return LabelPlan(SMOOTH_S, round(REACTION_S + late_s, 2), True, why if late_s else "")


def goes_by_lag(habits: SteeringHabits, driven_by: str) -> bool:
    """True if `plan_labels` goes by the lag, which takes pictures to measure."""
    return not driven_by and habits.kind in ("steps", "smooth")


_WHY: Final = {
    "none": "no steering",
    "constant": "constant steering",
    "too short": "too short to tell",
    "other scale": "another scale than -1..1?",
}
