"""The built-in simulator as a Gymnasium environment: `gymnasium.make("simulator:bc/Lake-v0")`.

docs/gymnasium.md describes observations, actions and rewards.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from numbers import Real
from typing import Any, Final, Literal

import cv2
import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from common.car import CAMERAS, Camera
from common.errors import first_of
from simulator.driving.expert import Expert
from simulator.driving.recovery_driving import steps_each
from simulator.driving.simulation import Simulation
from simulator.driving.vehicle import STEP_S
from simulator.rendering.camera import HEIGHT_PX, WIDTH_PX
from simulator.roads.track import is_drawn

Observation = dict[str, NDArray[Any]]

RATE_HZ: Final = 10.0
EXPERT_MPH: Final = 10.0
MAX_SPEED_MPH: Final = 100.0
"""The observed speed is clipped to -MAX_SPEED_MPH..MAX_SPEED_MPH. The car reaches 30 mph, and a little more
downhill."""


class DrivingEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """A car on a track of the built-in simulator.

    An observation is a dict: each of `cameras` as (160, 320, 3) uint8 RGB, and `speed_mph`, (1,) float32. An
    action is (2,) float32: steering, -1 (left) .. 1 (right), and throttle, -1 .. 1 (below 0 the car brakes, and at
    rest reverses), held for 1 / `rate_hz` seconds of simulated time.

    The reward is the progress along the road in the step, in metres; driving back is negative. An episode is
    terminated when `laps` are driven (a success), when the middle of the car leaves the road, or when the car
    makes less than a metre of progress in 5 s. A reset puts the car at rest on the centre line, at a random place
    that depends on the seed, or at `options["start_m"]`.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": RATE_HZ}  # noqa: RUF012 - Gymnasium's

    def __init__(
        self,
        track: str,
        *,
        cameras: Sequence[Camera] = ("center",),
        laps: float = 1.0,
        rate_hz: float = RATE_HZ,
        render_mode: str | None = None,
    ) -> None:
        """Raises ValueError if the track or a camera does not exist, if the rate does not divide 50, or if `laps`
        is not above 0."""
        if not cameras or not isinstance(cameras, Collection) or any(name not in CAMERAS for name in cameras):
            raise ValueError(f"cameras={cameras!r}: expected a list of some of {', '.join(CAMERAS)}")
        rate_hz, laps = _number("rate_hz", rate_hz), _number("laps", laps)
        if not 0.0 < laps < math.inf:
            raise ValueError(f"laps={laps!r}: expected a number above 0")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode={render_mode!r}: expected rgb_array or None")
        try:
            self._step_s = steps_each(rate_hz) * STEP_S
        except ValueError:  # names a command's flag
            raise ValueError(f"rate_hz={rate_hz!r}: it must divide 50 (as 5, 10, 12.5, 25 do)") from None
        self.metadata = {**type(self).metadata, "render_fps": rate_hz}
        self.render_mode = render_mode
        observed: dict[str, spaces.Space[Any]] = {
            camera: spaces.Box(0, 255, (HEIGHT_PX, WIDTH_PX, 3), np.uint8) for camera in cameras
        }
        observed["speed_mph"] = spaces.Box(-MAX_SPEED_MPH, MAX_SPEED_MPH, (1,), np.float32)
        self.observation_space: spaces.Space[Observation] = spaces.Dict(observed)  # type: ignore[assignment]
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._simulation = Simulation(track)
        self.course = self._simulation.course  # the car's place and progress
        self._cameras = tuple(cameras)
        self._end_m = laps * self._simulation.track.line.length_m
        self._expert = Expert(self._simulation.track.line, EXPERT_MPH)
        self._is_reset = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        super().reset(seed=seed)
        drawn_m = self.np_random.uniform(0.0, self._simulation.track.line.length_m)
        given = {"start_m": drawn_m} | (options or {})
        if unknown := given.keys() - {"start_m"}:
            raise ValueError(f"options={options!r}: no option {first_of(sorted(map(str, unknown)))}; only start_m")
        start_m = _number("start_m", given["start_m"])
        if not math.isfinite(start_m):
            raise ValueError(f"start_m={start_m!r}: expected a number of metres along the road")
        self.course.start(start_m)
        self._is_reset = True
        return self._observe(), self._info()

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold an action for a step. It is clamped to -1 .. 1. Raises ValueError if it is not two finite
        numbers."""
        try:
            command = np.asarray(action, np.float64)
        except (TypeError, ValueError):
            command = np.empty(0)
        if command.shape != (2,) or not np.isfinite(command).all():
            raise ValueError(f"action={action!r}: expected two finite numbers, steering and throttle")
        if not self._is_reset:
            raise ResetNeeded("call reset() before step()")
        before_m = self.course.progress_m
        self.course.advance(float(command[0]), float(command[1]), self._step_s)
        info = self._info()
        is_over: bool = info["success"] or self.course.intervention_due
        return self._observe(), self.course.progress_m - before_m, is_over, False, info

    def render(self) -> NDArray[np.uint8] | None:
        """The centre camera's picture, (160, 320, 3) RGB; None without a render mode."""
        return None if self.render_mode is None else self._picture("center")

    def expert_action(self) -> NDArray[np.float32]:
        """The action of the built-in expert in the current state, at a set speed of 10 mph."""
        return np.array(self._expert.control(self.course), np.float32)

    def _observe(self) -> Observation:
        speed = np.array([self.course.vehicle.speed_mph], np.float32)
        return {
            **{camera: self._picture(camera) for camera in self._cameras},
            "speed_mph": np.clip(speed, -MAX_SPEED_MPH, MAX_SPEED_MPH),
        }

    def _picture(self, camera: Camera) -> NDArray[np.uint8]:
        picture = cv2.cvtColor(self._simulation.picture(camera), cv2.COLOR_BGR2RGB)
        return picture.astype(np.uint8, copy=False)

    def _info(self) -> dict[str, Any]:
        success = self.course.progress_m >= self._end_m
        # Stable-Baselines3 and LeRobot read `is_success`.
        return {"lap": self.course.laps, "offset": self.course.offset, "success": success, "is_success": success}


class DrawnRoadEnv(DrivingEnv):
    """A random road, `random:SEED` or, with hairpins like the mountain's, `hairpins:SEED`."""

    def __init__(self, kind: Literal["random", "hairpins"], seed: int = 0, **settings: Any) -> None:
        track = f"{kind}:{seed}"
        if not is_drawn(track):
            raise ValueError(f"seed={seed!r}: expected a whole number of at most 18 digits, from 0 on")
        super().__init__(track, **settings)


def _number(name: str, value: object) -> float:
    if not isinstance(value, Real):
        raise ValueError(f"{name}={value!r}: expected a number, not {type(value).__name__}")
    return float(value)


def expert(env: gymnasium.Env[Any, Any], observation: object) -> NDArray[np.float32]:
    """The built-in expert for `bc-record gym`: `--expert simulator.environment:expert`."""
    driving = env.unwrapped
    if not isinstance(driving, DrivingEnv):
        raise TypeError(f"{type(driving).__name__}: this expert drives the built-in simulator only")
    return driving.expert_action()
