"""A Gymnasium environment of nothing but a bar, which steering moves; and its experts, good and bad.

`bc-record gym tests.helpers.toy_environment:toy/Bar-v0 --expert tests.helpers.toy_environment:centre`
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

HEIGHT, WIDTH = 48, 64
STEPS, RATE_HZ = 30, 20
MPS: Final = 4.0
PICTURE: Final = spaces.Box(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
STEER_AND_GAS: Final = spaces.Box(np.array([-1, 0], np.float32), np.array([1, 1], np.float32))


def bar(**settings: Any) -> list[str]:
    """The flag that names the bar by a file of settings, which is written to the working folder."""
    return ["--gym", bar_file(**settings)]


def bar_file(**settings: Any) -> str:
    """The bar's file of settings, which is written to the working folder."""
    settings = {"id": "tests.helpers.toy_environment:toy/Bar-v0", "action": "steering,throttle", **settings}
    args = settings.pop("args", {})
    lines = [f"{name} = {json.dumps(value)}" for name, value in settings.items()]
    if isinstance(args, dict):
        lines += [f"args.{name} = {json.dumps(value)}" for name, value in args.items()]
    else:
        lines += [f"args = {args}"]
    number = len(list(Path.cwd().glob("bar-*.toml")))
    (path := Path(f"bar-{number}.toml")).write_text("\n".join(lines))
    return str(path)


def with_bars(words: list[Any]) -> list[Any]:
    """The words, in which settings have become a bar's file."""
    return [part for word in words for part in (bar(**word) if isinstance(word, dict) else [word])]


class Bar(gymnasium.Env[Any, Any]):
    """A bar at `place`, -1 (left) .. 1 (right), which steering moves to its side. Its left half is red and its
    right half blue, so that nobody mistakes a mirror image, or RGB for BGR. `STEPS` are an episode."""

    def __init__(
        self,
        observation: str = "dict",
        action: str = "box",
        fps: int | None = RATE_HZ,
        limits: tuple[float, float] = (-1.0, 1.0),
    ) -> None:
        if not isinstance(limits, tuple):
            raise TypeError("limits are a tuple")
        self._low, self._high = limits
        self.metadata = {"render_modes": [], "render_fps": fps}
        speed = spaces.Box(0.0, 100.0, (1,), np.float32)
        seen: dict[str, spaces.Space[Any]] = {
            "dict": spaces.Dict({"pixels": spaces.Dict({"front": PICTURE}), "speed": speed}),
            "two": spaces.Dict({"front": PICTURE, "rear": PICTURE}),
            "picture": PICTURE,
            "numbers": speed,
        }
        seen["worded"] = seen["dict"]
        self._info = {"pace": "fast"} if observation == "worded" else {}
        self._kind = observation
        self.observation_space = seen[observation]
        self.action_space = spaces.Discrete(3) if action == "discrete" else STEER_AND_GAS
        self.place = 0.0
        self.actions: list[NDArray[np.float32]] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.place = float(self.np_random.uniform(-0.8, 0.8))
        self.actions.clear()
        return self._observe(), dict(self._info)

    def step(self, action: NDArray[np.float32]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert action in self.action_space
        self.actions.append(action)
        self.place = min(self._high, max(self._low, self.place + 0.1 * float(action[0])))
        return self._observe(), 1.0 - abs(self.place), False, len(self.actions) == STEPS, dict(self._info)

    def _observe(self) -> Any:
        picture = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
        column = round((self.place + 1.0) / 2.0 * (WIDTH - 9)) + 4
        picture[:, column - 4 : column + 4] = (20, 20, 230)
        picture[:, column - 4 : column] = (230, 20, 20)
        if self._kind == "picture":
            return picture
        if self._kind == "two":
            return {"front": picture, "rear": picture.copy()}
        return {"pixels": {"front": picture}, "speed": np.array([MPS], np.float32)}


def place_in(bgr: NDArray[np.uint8]) -> float:
    """The bar's place in a decoded picture: between its red and its blue half."""
    rows = bgr[HEIGHT // 2].astype(int)
    red, blue = np.flatnonzero(rows[:, 2] > 160), np.flatnonzero(rows[:, 0] > 160)
    assert red.max() < blue.min()
    return float(blue.min() - 4) / (WIDTH - 9) * 2.0 - 1.0


def centre(env: gymnasium.Env[Any, Any], observation: object) -> NDArray[np.float64]:
    bar = env.unwrapped
    assert isinstance(bar, Bar)
    return np.array([-0.5 * bar.place, 0.25])


def to_and_fro(env: gymnasium.Env[Any, Any], observation: object) -> list[float]:
    bar = env.unwrapped
    assert isinstance(bar, Bar)
    return [-0.5 if len(bar.actions) // 4 % 2 else 0.5, 0.25]


def nan_later(env: gymnasium.Env[Any, Any], observation: object) -> list[float]:
    bar = env.unwrapped
    assert isinstance(bar, Bar)
    return [math.nan if len(bar.actions) == 7 else 0.1, 0.0]


def too_many(env: gymnasium.Env[Any, Any], observation: object) -> list[float]:
    return [0.0, 0.0, 0.0]


def nothing(env: gymnasium.Env[Any, Any], observation: object) -> None:
    return None


def failing(env: gymnasium.Env[Any, Any], observation: object) -> float:
    raise ZeroDivisionError("the track has no width")


gymnasium.register("toy/Bar-v0", entry_point=f"{__name__}:Bar")
