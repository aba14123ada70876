"""The built-in simulator as a Gymnasium environment: `gymnasium.make("simulator:bc/Lake-v0")`.

Gymnasium is an extra: `pip install ".[gym]"`. docs/gymnasium.md describes what the
environments give and take.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import cv2
import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from common.car import CAMERAS, Camera
from simulator.driving.expert import Expert
from simulator.driving.recovery_driving import steps_each
from simulator.driving.simulation import Simulation
from simulator.driving.vehicle import STEP_S
from simulator.rendering.camera import HEIGHT_PX, WIDTH_PX

Observation = dict[str, NDArray[Any]]

RATE_HZ: Final = 10.0
EXPERT_MPH: Final = 10.0
MAX_SPEED_MPH: Final = 100.0
"""The bound of the observed speed, either way; the car reaches 30, and a few more downhill."""


class DrivingEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """A car on a track of the built-in simulator.

    An observation is a dict: each of `cameras` as (160, 320, 3) uint8 RGB, and `speed_mph`, (1,) float32. An
    action is (2,) float32: steering, -1 (left) .. 1 (right), and throttle, -1 .. 1 (below 0 it brakes, and at
    rest reverses), held for 1 / `rate_hz` seconds of simulated time.

    The reward is the road that was covered in the step, in metres, less what was driven back. An episode is
    terminated when `laps` are driven (a success), when the middle of the car leaves the road, and when the car has
    made no metre in 5 s. A reset puts the car at rest on the centre line at a place along the road that is drawn
    from the seed, or at `options["start_m"]`.
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
        """Raises ValueError for a track or camera that does not exist, for a rate that does not divide 50 and for
        laps that are none."""
        if not cameras or set(cameras) - set(CAMERAS):
            raise ValueError(f"cameras={cameras!r}: some of {', '.join(CAMERAS)} were expected")
        if not 0.0 < laps < math.inf:
            raise ValueError(f"laps={laps!r}: a number above 0 was expected")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode={render_mode!r}: rgb_array was expected, or None")
        self._step_s = steps_each(rate_hz) * STEP_S
        self.metadata = {**type(self).metadata, "render_fps": rate_hz}
        self.render_mode = render_mode
        observed: dict[str, spaces.Space[Any]] = {
            camera: spaces.Box(0, 255, (HEIGHT_PX, WIDTH_PX, 3), np.uint8) for camera in cameras
        }
        observed["speed_mph"] = spaces.Box(-MAX_SPEED_MPH, MAX_SPEED_MPH, (1,), np.float32)
        self.observation_space: spaces.Space[Observation] = spaces.Dict(observed)  # type: ignore[assignment]
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._simulation = Simulation(track)
        self.course = self._simulation.course
        """The car's place, and its progress."""
        self._cameras = tuple(cameras)
        self._end_m = laps * self._simulation.track.line.length_m
        self._expert = Expert(self._simulation.track.line, EXPERT_MPH)
        self._is_reset = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        super().reset(seed=seed)
        drawn_m = self.np_random.uniform(0.0, self._simulation.track.line.length_m)
        start_m = float((options or {}).get("start_m", drawn_m))
        if not math.isfinite(start_m):
            raise ValueError(f"start_m={start_m!r}: a number of metres along the road was expected")
        self.course.start(start_m)
        self._is_reset = True
        return self._observe(), self._info()

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Raises ValueError for an action that is not two finite numbers; they are clamped to -1 .. 1."""
        wanted = np.asarray(action, np.float64)
        if wanted.shape != (2,) or not np.isfinite(wanted).all():
            raise ValueError(f"action={action!r}: steering and throttle were expected, two finite numbers")
        if not self._is_reset:
            raise ResetNeeded("call reset() before step()")
        before_m = self.course.progress_m
        self.course.advance(float(wanted[0]), float(wanted[1]), self._step_s)
        info = self._info()
        is_over: bool = info["success"] or self.course.intervention_due
        return self._observe(), self.course.progress_m - before_m, is_over, False, info

    def render(self) -> NDArray[np.uint8] | None:
        """The centre camera's picture, (160, 320, 3) RGB; None without a render mode."""
        return None if self.render_mode is None else self._picture("center")

    def expert_action(self) -> NDArray[np.float32]:
        """The action of the built-in expert here, who drives at 10 mph."""
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
        # `is_success` is what Stable-Baselines3 and LeRobot look for.
        return {"lap": self.course.laps, "offset": self.course.offset, "success": success, "is_success": success}


class RandomRoadEnv(DrivingEnv):
    """The road `random:SEED`, which nobody has seen before: the same seed, the same road."""

    def __init__(self, seed: int = 0, **settings: Any) -> None:
        super().__init__(f"random:{seed}", **settings)


class HairpinRoadEnv(DrivingEnv):
    """The road `hairpins:SEED`: the same, with hairpins like the mountain's."""

    def __init__(self, seed: int = 0, **settings: Any) -> None:
        super().__init__(f"hairpins:{seed}", **settings)


def expert(env: gymnasium.Env[Any, Any], observation: object) -> NDArray[np.float32]:
    """The built-in expert for `bc-record --gym`: `--expert simulator.environment:expert`."""
    driving = env.unwrapped
    if not isinstance(driving, DrivingEnv):
        raise TypeError(f"{type(driving).__name__}: this expert drives the built-in simulator only")
    return driving.expert_action()
