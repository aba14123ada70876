"""The car: a bicycle model at 50 Hz that depends on the speed.

The wheels turn with a lag and a limited rate. The yaw rate follows the wheels with another lag. The grip limits
the lateral acceleration, so a bend that is easy at 10 mph is difficult at 30 mph. Engine and drag are those of the
Udacity simulator, measured in published recordings. The tyres are those of an ordinary car.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from common.car import BUILT_IN_WHEELBASE_M, MAX_STEERING_DEG, MPS_PER_MPH

STEP_S = 0.02  # the simulator applies commands at 50 Hz (Unity's fixed time step)
GRAVITY_MPS2 = 9.81

WHEELBASE_M = BUILT_IN_WHEELBASE_M
AXLE_TO_CENTRE_M = WHEELBASE_M / 2
MAX_WHEEL_RAD = math.radians(MAX_STEERING_DEG)

# The Udacity simulator turns its wheels at once, unlike a real car. A quick hand turns a steering wheel by ~900
# degrees a second, which is 60 degrees a second at the front wheels, with a steering ratio of 15.
STEERING_LAG_S = 0.1
STEERING_RATE_RADPS = math.radians(60.0)

# Peak friction of tyres on dry asphalt, a low value (Wong, Theory of Ground Vehicles, ch. 1).
GRIP = 0.8
# Cornering stiffness of an axle / load: 0.2 per degree (Gillespie, Fundamentals of Vehicle Dynamics, ch. 6).
CORNERING_PER_RAD = 12.0

# From rows of published recordings. With full throttle, the acceleration is 5.3 m/s² minus drag at every speed up
# to the simulator's maximum of 30 mph. Without throttle, the deceleration is 0.10 v + 0.05.
THROTTLE_MPS2 = 5.3
DRAG_PER_S = 0.10
ROLLING_MPS2 = 0.05
TOP_SPEED_MPS = 30.0 * MPS_PER_MPH
BRAKE_MPS2 = 6.0  # hard, but less than the grip, so that a braking car still steers
REVERSE_MPS2 = 2.5
REVERSE_SPEED_MPS = 5.0 * MPS_PER_MPH
# Soft ground: with full throttle, the car reaches about 18 mph.
OFF_ROAD_ROLLING_MPS2 = 2.0
OFF_ROAD_DRAG_PER_S = 0.3

# The engine's power fades to 0 over this range of speeds, so that full throttle equals the drag at the top speed.
_FADE_MPS = 1.5
_NO_POWER_MPS = TOP_SPEED_MPS + _FADE_MPS * (DRAG_PER_S * TOP_SPEED_MPS + ROLLING_MPS2) / THROTTLE_MPS2
_STEERING_SHARE = 1.0 - math.exp(-STEP_S / STEERING_LAG_S)  # share of the way to the command in one step


@dataclass(frozen=True, slots=True)
class CarState:
    """Position and motion of the car. Angles and rates are counter-clockwise: positive is LEFT."""

    x_m: float  # of the car's centre, in the middle between the axles
    y_m: float
    heading_rad: float  # from +x
    speed_mps: float = 0.0  # along the heading, in the ground plane; negative in reverse
    wheel_angle_rad: float = 0.0  # of the front wheels
    yaw_rate_radps: float = 0.0

    @property
    def speed_mph(self) -> float:
        return self.speed_mps / MPS_PER_MPH

    @property
    def steering(self) -> float:
        """The wheels' angle, normalised as in the simulator: -1 (25 degrees left) .. 1 (25 degrees right)."""
        return -self.wheel_angle_rad / MAX_WHEEL_RAD

    @property
    def lateral_mps2(self) -> float:
        """The lateral acceleration, positive to the left."""
        return self.speed_mps * self.yaw_rate_radps

    @property
    def rear_slip_rad(self) -> float:
        """The slip angle of the rear axle, outwards in a bend: lateral force / cornering stiffness."""
        return self.lateral_mps2 / (CORNERING_PER_RAD * GRAVITY_MPS2)


def step(
    state: CarState, steering: float, throttle: float, slope: float = 0.0, off_road: bool = False
) -> CarState:
    """The state ``STEP_S`` later.

    ``steering`` -1 (left) .. 1 (right) and ``throttle`` -1 .. 1 are clamped to their ranges. Throttle above 0
    accelerates; below 0 it brakes a car that rolls forward, then reverses slowly, as in Udacity's simulator.
    ``slope`` is the rise over run of the ground along the heading.
    """
    wheel = _turn_wheels(state.wheel_angle_rad, steering)
    speed, tyre_mps2 = _change_speed(state.speed_mps, min(1.0, max(-1.0, throttle)), slope, off_road)
    # Driving and braking use a part of the grip, which is not available in a bend (the friction circle).
    grip_mps2 = math.sqrt((GRIP * GRAVITY_MPS2) ** 2 - tyre_mps2**2)
    yaw_rate = _change_yaw_rate(state.yaw_rate_radps, wheel, speed, grip_mps2)

    # Sideways motion of the centre: the rear axle moves along the heading, except for its slip angle.
    slip = speed * yaw_rate / (CORNERING_PER_RAD * GRAVITY_MPS2)
    sideways = AXLE_TO_CENTRE_M * yaw_rate - abs(speed) * slip
    heading = state.heading_rad + yaw_rate * STEP_S / 2  # in the middle of the step
    cos, sin = math.cos(heading), math.sin(heading)
    return CarState(
        state.x_m + (speed * cos - sideways * sin) * STEP_S,
        state.y_m + (speed * sin + sideways * cos) * STEP_S,
        state.heading_rad + yaw_rate * STEP_S,
        speed,
        wheel,
        yaw_rate,
    )


def resistance_mps2(speed_mps: float, off_road: bool = False) -> float:
    """The deceleration by drag and rolling resistance of a car that moves at ``speed_mps`` (0 or more)."""
    resistance = DRAG_PER_S * abs(speed_mps) + ROLLING_MPS2
    if off_road:
        resistance += OFF_ROAD_DRAG_PER_S * abs(speed_mps) + OFF_ROAD_ROLLING_MPS2
    return resistance


def slope_mps2(slope: float) -> float:
    """The deceleration by gravity of a car that climbs ``slope`` (rise over run)."""
    return GRAVITY_MPS2 * slope / math.sqrt(1.0 + slope * slope)


def wheel_angle_for(curvature_per_m: float, speed_mps: float) -> float:
    """The wheel angle in rad (within +-25 degrees) for a bend, including understeer.

    For a bend that needs more than 0.9 of the grip: the angle for a bend that needs 0.9.
    """
    grip_mps2 = GRIP * GRAVITY_MPS2
    kinematic = curvature_per_m
    if speed_mps > 0.1:
        share = min(0.9, max(-0.9, speed_mps**2 * curvature_per_m / grip_mps2))
        kinematic = math.atanh(share) * grip_mps2 / speed_mps**2
    angle = math.atan(WHEELBASE_M * kinematic)
    return min(MAX_WHEEL_RAD, max(-MAX_WHEEL_RAD, angle))


def _turn_wheels(wheel_rad: float, steering: float) -> float:
    """The next wheel angle: a first-order lag with a limited rate. Steering to the right is a negative angle."""
    target = -MAX_WHEEL_RAD * min(1.0, max(-1.0, steering))
    max_turn_rad = STEERING_RATE_RADPS * STEP_S
    return wheel_rad + min(max_turn_rad, max(-max_turn_rad, (target - wheel_rad) * _STEERING_SHARE))


def _change_speed(speed: float, throttle: float, slope: float, off_road: bool) -> tuple[float, float]:
    """The next speed, and the magnitude of the acceleration by the tyres."""
    drive, brake = 0.0, 0.0
    if throttle >= 0.0:
        drive = throttle * THROTTLE_MPS2 * min(1.0, max(0.0, (_NO_POWER_MPS - speed) / _FADE_MPS))
    elif speed > 0.0:
        brake = -throttle * BRAKE_MPS2
    else:
        drive = throttle * REVERSE_MPS2 * max(0.0, 1.0 + speed / REVERSE_SPEED_MPS)
    pushed = speed + (drive - slope_mps2(slope)) * STEP_S
    # Resistance and brakes stop the car, but never reverse its direction.
    held = (resistance_mps2(speed, off_road) + brake) * STEP_S
    return math.copysign(max(0.0, abs(pushed) - held), pushed), abs(drive) + brake


def _change_yaw_rate(yaw_rate: float, wheel_rad: float, speed: float, grip_mps2: float) -> float:
    """The next yaw rate: it follows v tan(angle) / wheelbase, limited by the grip (grip / v).

    The lag is that of the linear bicycle model with yaw inertia m a b and equal axles, v / (stiffness g): none
    at walking pace, 0.11 s at 30 mph. The hyperbolic tangent approximates the tyre's force over slip.
    """
    rolling = abs(speed)
    if rolling < 1e-3:
        return 0.0
    max_yaw_rate = grip_mps2 / rolling
    target = max_yaw_rate * math.tanh(speed * math.tan(wheel_rad) / (WHEELBASE_M * max_yaw_rate))
    lag = rolling / (CORNERING_PER_RAD * GRAVITY_MPS2)
    yaw_rate += (target - yaw_rate) * STEP_S / (STEP_S + lag)
    return min(max_yaw_rate, max(-max_yaw_rate, yaw_rate))
