"""A simple expert for CarRacing-v3, which reads the track: `--expert examples/car_racing_expert.py:drive`.

It steers towards a point of the track's middle ahead of the car, and keeps a steady speed, slower where the track
ahead turns. Where the car has been turned away from the track, it slows down first.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

AHEAD = 2  # tiles from the nearest one to the one that is steered to, and one more for each AHEAD_SPEED
AHEAD_SPEED = 12.0
BEND_TILES = 10  # the speed is chosen for the bend within this many tiles
FAST, SLOW = 75.0, 35.0  # on a straight, and where those tiles turn by half a circle
ASTRAY = 0.8  # radians: a car that is turned so far away slides


def drive(env: Any, observation: object) -> np.ndarray:
    """The action, (steering, gas, brake), at the present state."""
    racing = env.unwrapped
    hull = racing.car.hull
    # each tile of the track: its angle along the loop, its direction, and its place
    places = np.array([(x, y) for _, _, x, y in racing.track])
    x, y = hull.position
    speed = math.hypot(*hull.linearVelocity)
    nearest = int(np.argmin(np.hypot(*(places - (x, y)).T)))
    goal_x, goal_y = places[(nearest + AHEAD + int(speed / AHEAD_SPEED)) % len(places)] - (x, y)
    # Box2D's hull looks along +y at angle 0; a turn to the left is positive
    turn = math.remainder(math.atan2(goal_y, goal_x) - (hull.angle + math.pi / 2), math.tau)
    headings = np.unwrap([racing.track[(nearest + k) % len(places)][1] for k in range(BEND_TILES)])
    bend = min(1.0, abs(headings[-1] - headings[0]) / math.pi)
    wanted = FAST - (FAST - SLOW) * min(1.0, 2.0 * bend) if abs(turn) < ASTRAY else SLOW / 2
    gas = min(0.5, max(0.0, 0.05 * (wanted - speed))) * max(0.1, 1.0 - 2.0 * abs(turn))  # it would spin
    brake = min(0.5, max(0.0, 0.02 * (speed - wanted - 5.0)))
    return np.array([max(-1.0, min(1.0, -2.0 * turn)), gas, brake])
