"""Any Gymnasium environment as a car with one camera: its picture, its speed, and the numbers of its action.

An environment is other people's code. It runs because the user named it, and its output is checked.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from common.closeable import Closeable
from common.errors import UsageError, brief, counted, printable
from common.named_function import in_one_line, load_function
from recorder.errors import RecordingError
from recorder.sources.settings import MAX_HZ, MIN_HZ, GymFlags, environment_settings

if TYPE_CHECKING:
    import gymnasium


NAMES: Final = ("steering", "throttle", "brake", "pedals")
"""`pedals` is the throttle minus the brake, in one number."""

_NUMBER: Final = r"[+-]?(?:\d+\.?\d*|\.\d+)"
_PART: Final = re.compile(rf"(?:({_NUMBER})|(?:({_NUMBER})\*|(-))?({'|'.join(NAMES)}))", re.ASCII)


@dataclass(frozen=True)
class CarCommand:
    steering: float  # -1 (left) .. 1 (right)
    throttle: float = 0.0  # 0 .. 1
    brake: float = 0.0  # 0 .. 1


@dataclass(frozen=True)
class _Part:
    name: str  # empty for a constant
    factor: float  # the action's number divided by ours; or the constant


class ActionMap:
    """Converts commands to actions, and actions to commands. Its text has a part for each number of the action,
    separated by commas: a name, a name with a factor (`-steering`, `0.5*throttle`), or a constant."""

    def __init__(self, text: str) -> None:
        """Raises ValueError for another text, or one without steering."""
        self.text = text
        self._parts = [_parse(part.strip()) for part in text.split(",")]
        names = [part.name for part in self._parts if part.name]
        if names.count("steering") != 1:
            raise ValueError("one number of the action has to be the steering")
        if len(set(names)) < len(names) or ("pedals" in names and {"throttle", "brake"} & set(names)):
            raise ValueError("throttle and brake may be given once each, or pedals for both")
        self.has_pedals = len(names) > 1

    def __len__(self) -> int:
        return len(self._parts)

    def action(self, command: CarCommand) -> NDArray[np.float64]:
        values = {
            "": 1.0,
            "steering": command.steering,
            "throttle": command.throttle,
            "brake": command.brake,
            "pedals": command.throttle - command.brake,
        }
        return np.array([part.factor * values[part.name] for part in self._parts])

    def turned(self, action: NDArray[np.float64], by: float) -> NDArray[np.float64]:
        """An action (N,) with `by` added to its steering."""
        added = [part.factor * by if part.name == "steering" else 0.0 for part in self._parts]
        return np.add(action, added, dtype=np.float64)

    def command(self, action: NDArray[Any]) -> CarCommand:
        """The command of an action (N,), limited to its ranges. Missing pedals are 0."""
        named = {
            part.name: float(number) / part.factor
            for part, number in zip(self._parts, action, strict=True)
            if part.name
        }
        pedals = named.get("pedals", 0.0)
        return CarCommand(
            steering=min(max(named["steering"], -1.0), 1.0),
            throttle=min(max(named.get("throttle", pedals), 0.0), 1.0),
            brake=min(max(named.get("brake", -pedals), 0.0), 1.0),
        )


def _parse(text: str) -> _Part:
    match = _PART.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r}: expected a number, or {', '.join(NAMES)} with or without a factor")
    constant, factor, minus, name = match.groups()
    if name is None:
        return _Part("", float(constant))
    value = -1.0 if minus else float(factor or 1.0)
    if value == 0.0 or not math.isfinite(1.0 / value):
        raise ValueError(f"{text!r}: expected a factor other than 0")
    return _Part(name, value)


_JPEG: Final = (
    *(cv2.IMWRITE_JPEG_QUALITY, 95),
    *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444),  # pictures may be small
)

MIN_PX: Final = 16  # a side; no camera has smaller pictures

_SPEED: Final = re.compile(r"(?:(-?\d+\.?\d*|\.\d+)\*)?(.+)", re.ASCII)


@dataclass(frozen=True)
class GymnasiumMoment:
    """The state after a reset or a step."""

    observation: Any
    picture: NDArray[np.uint8]  # (height, width, 3) RGB, or grey with one channel or none
    speed_mph: float  # NaN if it is unknown
    reward: float = 0.0
    end: str = ""  # "terminated" or "truncated" where the episode has ended

    @property
    def size(self) -> tuple[int, int]:
        return self.picture.shape[1], self.picture.shape[0]

    def jpeg(self) -> bytes:
        """The picture as it is recorded, and driven on."""
        is_grey = self.picture.ndim == 2 or self.picture.shape[2] == 1
        bgr = cv2.cvtColor(self.picture, cv2.COLOR_GRAY2BGR if is_grey else cv2.COLOR_RGB2BGR)
        return cv2.imencode(".jpg", bgr, _JPEG)[1].tobytes()


class GymnasiumCar(Closeable):
    def __init__(self, flags: GymFlags) -> None:
        """Makes the environment.

        Raises UsageError for invalid flags, UserError for a missing expert, RecordingError for an environment that
        is missing or cannot be driven with these flags.
        """
        if flags.episodes < 1:
            raise UsageError(f"--episodes {flags.episodes}: expected a number above 0")
        self.settings = environment_settings(flags)
        self.name = self.settings.id
        self._flags = flags
        self._speed_factor, self._speed_key = _parse_speed(self.settings.speed)
        self.actions = _parse_action(self.settings.action)
        self._expert = None if flags.expert is None else load_function("--expert", flags.expert)
        self.env = _make(self.name, _with_tuples(self.settings.args))
        try:
            self._picture_key = _find_picture(self.name, self.env.observation_space, self.settings.picture)
            self._space = self._check_action()
            self._check_rate()
        except BaseException:
            self.env.close()
            raise
        self._steps = 0

    @property
    def has_expert(self) -> bool:
        return self._expert is not None

    @property
    def has_speed(self) -> bool:
        return self._speed_key is not None

    @property
    def max_steps(self) -> int | None:
        """The length of an episode; None if it has no limit."""
        return None if self.env.spec is None else self.env.spec.max_episode_steps

    @property
    def rate_hz(self) -> float:
        """Steps a second of the environment's own time."""
        return float(self.settings.rate_hz or self.env.metadata["render_fps"])

    def reset(self, seed: int) -> GymnasiumMoment:
        self._steps = 0
        with _errors_of(f"{self.name}", f"its reset with seed {seed}"):
            observation, info = self.env.reset(seed=seed)
        return self._moment(observation, info)

    def step(self, action: NDArray[Any]) -> GymnasiumMoment:
        """One step by an action in the environment's form, limited to its range."""
        self._steps += 1
        sent = np.clip(action.reshape(self._space.shape), self._space.low, self._space.high)
        with _errors_of(f"{self.name}", f"its step {self._steps}"):
            observation, given, terminated, truncated, info = self.env.step(sent.astype(self._space.dtype))
            reward = float(given)
        end = "terminated" if terminated else "truncated" if truncated else ""
        return self._moment(observation, info, reward, end)

    def expert_action(self, moment: GymnasiumMoment) -> NDArray[np.float64]:
        """The expert's action (N,). Raises RecordingError for anything else."""
        assert self._expert is not None  # noqa: S101
        with _errors_of(f"--expert {self._flags.expert}", f"at step {self._steps} it"):
            given = self._expert(self.env, moment.observation)
        try:
            action = np.asarray(given, np.float64)
        except (TypeError, ValueError):
            action = np.zeros(0)
        where = f"--expert {self._flags.expert}: at step {self._steps}"
        if action.size != len(self.actions):
            kind = f"an array of shape {action.shape}" if action.size else f"{type(given).__name__}"
            raise RecordingError(f"{where} it gave {kind}; expected an action of {len(self.actions)} numbers")
        if not np.isfinite(action).all():
            raise RecordingError(f"{where} it gave {action.ravel().tolist()}: expected finite numbers")
        return action.ravel()

    def expert_command(self, moment: GymnasiumMoment) -> CarCommand:
        return self.actions.command(self.expert_action(moment))

    def close(self) -> None:
        self.env.close()

    def _check_action(self) -> Any:
        from gymnasium.spaces import Box

        space = self.env.action_space
        if not isinstance(space, Box):
            hint = "; CarRacing-v3 has a steering wheel with continuous = true"
            raise RecordingError(
                f"{self.name}: its actions are {_named(space)}; expected numbers in a Box, and one of"
                f" them the steering{hint if 'CarRacing' in self.name else ''}"
            )
        size = math.prod(space.shape)
        if size != len(self.actions):
            raise RecordingError(
                f"{self.name}: its action has {counted(size, 'number')}, {_named(space)}: a file of settings"
                f' names each: action = "steering,throttle,brake"; {self.actions.text} is {len(self.actions)}'
            )
        return space

    def _check_rate(self) -> None:
        render_fps = self.env.metadata.get("render_fps")
        if (rate_hz := self.settings.rate_hz) is not None:
            if not MIN_HZ <= rate_hz <= MAX_HZ:
                raise UsageError(f"rate_hz {rate_hz:g}: expected {MIN_HZ:g} to {MAX_HZ:,.0f}")
        elif not isinstance(render_fps, int | float) or not MIN_HZ <= render_fps <= MAX_HZ:
            raise RecordingError(
                f"{self.name}: its render_fps is {render_fps}: give its steps a second as rate_hz"
            )

    def _moment(
        self, observation: Any, info: dict[str, Any], reward: float = 0.0, end: str = ""
    ) -> GymnasiumMoment:
        picture = observation
        try:
            for key in self._picture_key:
                picture = picture[key]
            size = picture.shape[:2]
        except (TypeError, KeyError, AttributeError, IndexError):
            size = ()
        if len(size) != 2 or min(size) < MIN_PX or picture.dtype != np.uint8:
            raise RecordingError(f"{self.name}: step {self._steps} gave no picture, although its spaces have one")
        return GymnasiumMoment(observation, picture, self._speed_mph(observation, info), reward, end)

    def _speed_mph(self, observation: Any, info: dict[str, Any]) -> float:
        if self._speed_key is None:
            return math.nan
        for place in (observation, info):
            if isinstance(place, dict) and self._speed_key in place:
                with contextlib.suppress(TypeError, ValueError):  # text or several numbers
                    if math.isfinite(speed := float(np.asarray(place[self._speed_key]).item())):
                        return self._speed_factor * speed
        if not self._steps:
            return math.nan  # info may have it only from the first step on
        keys = sorted({*(observation if isinstance(observation, dict) else ()), *info})
        raise RecordingError(
            f"{self.name}: speed {self.settings.speed}: no such number in its observation or info (there is:"
            f" {printable(', '.join(map(str, keys))) or 'nothing'})"
        )


def _with_tuples(setting: Any) -> Any:
    """A setting with a tuple for each table {tuple = [...]}: TOML has no tuples."""
    if isinstance(setting, list):
        return [_with_tuples(value) for value in setting]
    if not isinstance(setting, dict):
        return setting
    if setting.keys() == {"tuple"} and isinstance(setting["tuple"], list):
        return tuple(_with_tuples(setting["tuple"]))
    return {name: _with_tuples(value) for name, value in setting.items()}


def _make(name: str, arguments: dict[str, Any]) -> gymnasium.Env[Any, Any]:
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # a greeting on standard output, among results
    import gymnasium  # slow

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # about other people's code
            return gymnasium.make(name, **arguments)
    except Exception as error:  # of Gymnasium's, or of the environment's own code
        raise RecordingError(f"{printable(name)}: cannot be made ({in_one_line(error)})") from None


@contextlib.contextmanager
def _errors_of(code: str, action: str) -> Iterator[None]:
    """Turn an error in other people's code into one line."""
    try:
        yield
    except Exception as error:
        raise RecordingError(f"{code}: {action} failed ({in_one_line(error)})") from error


def _parse_action(text: str) -> ActionMap:
    try:
        return ActionMap(text)
    except ValueError as error:
        raise UsageError(f"action {text}: {error}; such as steering,throttle,brake") from None


def _parse_speed(text: str | None) -> tuple[float, str | None]:
    if text is None:
        return 1.0, None
    match = _SPEED.fullmatch(text)
    if match is None:
        raise UsageError(f"speed {text!r}: expected a key, such as speed, or 2.237*speed")
    return float(match[1] or 1.0), match[2]


def _find_picture(name: str, space: Any, key: str | None) -> tuple[str, ...]:
    """The keys that lead to the camera's picture."""
    pictures = [keys for keys, part in _parts(space) if _is_picture(part)]
    shown = ", ".join(".".join(keys) for keys in pictures)
    if key is not None:
        wanted = tuple(key.split("."))
        if wanted in pictures:
            return wanted
        raise RecordingError(
            f"{name}: picture {key}: its observation has no such picture; it has: {shown or 'none'}"
        )
    if not pictures:
        raise RecordingError(
            f"{name}: no camera picture in its observation, {_named(space)}: expected (height, width, 3) of uint8"
        )
    if len(pictures) > 1:
        raise RecordingError(f"{name}: which picture? Give its key as picture, one of {shown}")
    return pictures[0]


def _parts(space: Any, keys: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], Any]]:
    """The spaces in nested Dict spaces, with the keys that lead to them."""
    from gymnasium.spaces import Dict

    if not isinstance(space, Dict):
        return [(keys, space)]
    return [part for key, inner in space.spaces.items() for part in _parts(inner, (*keys, str(key)))]


def _is_picture(space: Any) -> bool:
    from gymnasium.spaces import Box

    if not isinstance(space, Box) or space.dtype != np.uint8 or len(space.shape) not in (2, 3):
        return False
    return min(space.shape[:2]) >= MIN_PX and (len(space.shape) == 2 or space.shape[2] in (1, 3))


def _named(space: Any) -> str:
    return brief(" ".join(str(space).split()), 100)
