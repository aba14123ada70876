"""A player of the page of a drive: it sees only what the page shows, has a person's reaction time, and sends real
input events.

Keys and mouse are operated by the simulated keyboard and mouse drivers (docs/studies/drivers.md), with the page's
map as their road. A gamepad's stick follows the wanted steering 0.2 s late, as a hand does. Players use the
drive's clock: if a computer drives in slow motion, the players are slower, too.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Literal, cast

from drive_page import DrivePage, RoadMap, Seen

from common.car import MPS_PER_MPH
from simulator.driving.course import Course
from simulator.driving.expert import Expert
from simulator.driving.person import FULL_LOCK_PX, REACTION_S, KeyboardDriver, MouseDriver, Person
from simulator.driving.vehicle import CarState
from simulator.roads.centreline import Centreline

Device = Literal["keys", "mouse", "gamepad"]
DEVICES: Final[tuple[Device, ...]] = ("keys", "mouse", "gamepad")

LOOKS_HZ: Final = 40.0
NOISE: Final = 0.03
_STICK_LOOK_AHEAD_S: Final = 0.9
_HAND_S: Final = 0.1  # the time constant of a thumb
_DEAD_ZONE, _CURVE = 0.1, 1.5  # the page's defaults: a player knows how the stick responds
_TURN_S: Final = 0.15  # the time over which a player estimates the car's yaw rate
_HANDS_OFF_S: Final = 10.0  # step of the drivers' clock after the car was put back


@dataclass
class Sight:
    """The car on the map, with the attributes of a `Course` that the built-in drivers read."""

    line: Centreline
    vehicle: CarState
    arc_m: float
    offset_m: float
    half_width_m: float
    time_s: float
    off_road: bool = False  # a page does not show it

    @property
    def aside(self) -> float:
        """The car's distance from the middle, as a share of half the road's width."""
        return abs(self.offset_m) / self.half_width_m

    @property
    def turned_rad(self) -> float:
        """The car's heading relative to the road, positive to the left."""
        angle = self.vehicle.heading_rad - self.line.at(self.arc_m).heading_rad
        return (angle + math.pi) % (2 * math.pi) - math.pi

    def aside_in(self, seconds: float) -> float:
        """`aside` after some seconds, if the car keeps its speed and its yaw rate."""
        car = self.vehicle
        heading, speed = car.heading_rad + car.yaw_rate_radps * seconds / 2, car.speed_mps
        x = car.x_m + speed * seconds * math.cos(heading)
        y = car.y_m + speed * seconds * math.sin(heading)
        _, offset_m = self.line.project(x, y, self.arc_m + speed * seconds)
        return abs(offset_m) / self.half_width_m

    @property
    def course(self) -> Course:
        """This sight as a `Course`: it has everything that the built-in drivers read."""
        return cast(Course, self)


class Eyes:
    """Locates the car on the road by what the page shows."""

    def __init__(self, page: DrivePage) -> None:
        self._page = page
        self.map = RoadMap(page)
        self.seen = page.see()
        self._before: deque[tuple[float, float]] = deque()  # the drive's time, heading
        self._looked_s = time.monotonic()
        self._time_s = 0.0  # of the drive's clock

    def look(self) -> Sight:
        put_back, frame = self.seen.put_back, self.seen.frame
        self.seen = self._page.see()
        looked_s = time.monotonic()
        self._time_s += (looked_s - self._looked_s) * self.seen.pace
        self._looked_s = looked_s
        if self.seen.put_back != put_back:
            self._before.clear()
            self._time_s += _HANDS_OFF_S
        now_s = self._time_s
        if self.seen.frame != frame or not self._before:
            self._before.append((now_s, self.seen.heading_rad))
        while len(self._before) > 2 and self._before[1][0] < now_s - _TURN_S:
            self._before.popleft()
        (first_s, first_rad), (last_s, last_rad) = self._before[0], self._before[-1]
        turn = (last_rad - first_rad + math.pi) % (2 * math.pi) - math.pi
        yaw = turn / (last_s - first_s) if last_s - first_s > _TURN_S / 3 else 0.0
        seen, line = self.seen, self.map.line
        arc_m, offset_m = line.project(seen.x_m, seen.y_m, self.map.arc_m(seen))
        half_m = float(self.map.half_width_m[round(arc_m / line.step_m) % len(line.points_m)])
        car = CarState(seen.x_m, seen.y_m, seen.heading_rad, seen.speed_mph * MPS_PER_MPH, yaw_rate_radps=yaw)
        return Sight(line, car, arc_m, offset_m, half_m, now_s)


class Hands(ABC):
    """Hands on a device of the page."""

    @abstractmethod
    def act(self, sight: Sight) -> None: ...

    @abstractmethod
    def let_go(self) -> None: ...


class KeyHands(Hands):
    def __init__(self, page: DrivePage, line: Centreline, mph: float, seed: int) -> None:
        self._keyboard = page.page.keyboard
        self._person: Person = KeyboardDriver(line, mph, NOISE, seed)
        self._held = ""

    def act(self, sight: Sight) -> None:
        self._person.control(sight.course)
        act = self._person.act
        key = "" if act is None or not act.is_held(sight.time_s) else "ArrowLeft" if act.side < 0 else "ArrowRight"
        self._hold(key)

    def let_go(self) -> None:
        self._hold("")

    def _hold(self, key: str) -> None:
        if key == self._held:
            return
        if self._held:
            self._keyboard.up(self._held)
        if key:
            self._keyboard.down(key)
        self._held = key


class MouseHands(Hands):
    def __init__(self, page: DrivePage, line: Centreline, mph: float, seed: int) -> None:
        self._mouse = page.page.mouse
        self._person: Person = MouseDriver(line, mph, NOISE, seed)
        self._is_down = False
        box = page.page.locator("#picture").bounding_box()
        assert box is not None  # noqa: S101
        self._from = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def act(self, sight: Sight) -> None:
        steering, _ = self._person.control(sight.course)
        act = self._person.act
        is_held = act is not None and act.is_held(sight.time_s)
        if not is_held:
            return self.let_go()
        x, y = self._from
        if not self._is_down:
            self._mouse.move(x, y)
            self._mouse.down()
            self._is_down = True
        self._mouse.move(x + steering * FULL_LOCK_PX, y)

    def let_go(self) -> None:
        if self._is_down:
            self._mouse.up()
            self._is_down = False


class StickHands(Hands):
    def __init__(self, page: DrivePage, line: Centreline, mph: float, seed: int) -> None:
        self._page = page.page
        self._expert = Expert(line, mph, NOISE, seed, _STICK_LOOK_AHEAD_S)
        self._wanted: deque[tuple[float, float]] = deque()  # from when on, steering
        self._steering = 0.0
        self._before_s = 0.0

    def act(self, sight: Sight) -> None:
        now_s = sight.time_s
        if not 0 < now_s - self._before_s < 1:
            self._wanted.clear()
            self._steering, self._before_s = 0.0, now_s
        steering, _ = self._expert.control(sight.course)
        self._wanted.append((now_s + REACTION_S, steering))
        while len(self._wanted) > 1 and self._wanted[1][0] <= now_s:
            self._wanted.popleft()
        wanted = self._wanted[0][1] if self._wanted[0][0] <= now_s else 0.0
        self._steering += (wanted - self._steering) * (1 - math.exp((self._before_s - now_s) / _HAND_S))
        self._before_s = now_s
        self._push(self._steering)

    def let_go(self) -> None:
        self._wanted.clear()
        self._steering = 0.0
        self._push(0.0)

    def _push(self, steering: float) -> None:
        """Move the stick to the position for this steering."""
        way = _DEAD_ZONE + (1 - _DEAD_ZONE) * abs(steering) ** (1 / _CURVE) if abs(steering) > 1e-3 else 0.0
        self._page.evaluate("way => { window.stick = way; }", math.copysign(min(1.0, way), steering))


_HANDS: Final[Mapping[Device, Callable[[DrivePage, Centreline, float, int], Hands]]] = {
    "keys": KeyHands,
    "mouse": MouseHands,
    "gamepad": StickHands,
}


class Player:
    """Looks at the page and acts. Call `step` repeatedly."""

    def __init__(self, page: DrivePage, device: Device, seed: int, mph: float = 10.0) -> None:
        self.eyes = Eyes(page)
        self.hands: Hands = _HANDS[device](page, self.eyes.map.line, mph, seed)
        self._due_s = time.monotonic()

    @property
    def seen(self) -> Seen:
        return self.eyes.seen

    def look(self) -> Sight:
        """Wait until the next look is due. Returns the car on the map."""
        self._due_s = max(self._due_s + 1 / LOOKS_HZ, time.monotonic())
        time.sleep(max(0.0, self._due_s - time.monotonic()))
        return self.eyes.look()

    def step(self) -> Sight:
        sight = self.look()
        if not self.seen.is_ended:
            self.hands.act(sight)
        return sight


_TAKE_OVER_ASIDE: Final = 0.9  # share of half the road's width, now or after `_TAKE_OVER_IN_S`
_TAKE_OVER_IN_S: Final = 1.0
_STEADY_ASIDE, _STEADY_RAD, _STEADY_S = 0.3, 0.07, 1.0


class Supervisor:
    """A player who lets a network drive, takes over before it leaves the road, and hands back."""

    def __init__(self, page: DrivePage, player: Player) -> None:
        self._keyboard = page.page.keyboard
        self._player = player
        self._danger_s: float | None = None
        self._steady_s: float | None = None
        self.is_driving = False

    def step(self) -> None:
        sight = self._player.look()
        if self._player.seen.is_ended:
            return
        if self.is_driving:
            self._drive(sight)
        else:
            self._watch(sight)

    def _watch(self, sight: Sight) -> None:
        is_leaving = max(sight.aside, sight.aside_in(_TAKE_OVER_IN_S)) > _TAKE_OVER_ASIDE
        self._danger_s = (self._danger_s or sight.time_s) if is_leaving else None
        if self._danger_s is not None and sight.time_s - self._danger_s >= REACTION_S:
            self.is_driving, self._steady_s, self._danger_s = True, None, None

    def _drive(self, sight: Sight) -> None:
        self._player.hands.act(sight)
        is_steady = sight.aside < _STEADY_ASIDE and abs(sight.turned_rad) < _STEADY_RAD
        self._steady_s = (self._steady_s or sight.time_s) if is_steady else None
        if self._steady_s is not None and sight.time_s - self._steady_s >= _STEADY_S:
            self._player.hands.let_go()
            self._keyboard.press("h")
            self.is_driving = False
