"""Tracks by name: ``lake``, ``mountain``, ``random:SEED`` and ``hairpins:SEED``."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.errors import did_you_mean
from simulator.roads.built_in_tracks import LAKE, MOUNTAIN
from simulator.roads.centreline import Centreline, Floats
from simulator.roads.random_road import hairpin_road, random_road
from simulator.roads.road_stretches import Look, trace

WIDTH_SMOOTHING_M = 4.0


@dataclass(frozen=True)
class Track:
    """A closed road and its looks.

    ``half_width_m``, (N,) float64, is the distance from the centre line to the road's edges at each of the N
    points of ``line``. A car is off the road if its middle is farther away. ``look_index``, (N,), is the position
    of each point's look in ``looks``.
    """

    name: str
    line: Centreline
    half_width_m: Floats
    looks: tuple[Look, ...]
    look_index: NDArray[np.intp]

    def fingerprint(self) -> str:
        """A hash of everything on which the track's world depends."""
        # It includes the names of Look and Edge and of their fields: renaming them would change the fingerprint.
        digest = hashlib.sha256(repr((self.name, self.looks)).encode())
        for values in (self.line.points_m, self.half_width_m, self.look_index.astype(np.int64)):
            digest.update(np.ascontiguousarray(values).tobytes())
        return digest.hexdigest()


def load_track(name: str) -> Track:
    """The track ``lake``, ``mountain``, ``random:SEED`` or ``hairpins:SEED`` (SEED: 0, 1, ...).

    Raises ``ValueError`` for any other name.
    """
    built_in = {"lake": LAKE, "mountain": MOUNTAIN}.get(name)
    if built_in is not None:
        points, index = trace(built_in)
        return make_track(name, points, tuple(s.look for s in built_in), index)
    if not is_drawn(name):
        meant = did_you_mean(name.lower(), ("lake", "mountain", "random:7", "hairpins:7"))
        choice = "Choose lake, mountain, random:SEED or hairpins:SEED (such as random:7)"
        raise ValueError(f"no such track{f'; {meant}' if meant else '.'} {choice}")
    kind, _, seed = name.partition(":")
    points, looks, index = (random_road if kind == "random" else hairpin_road)(int(seed))
    return make_track(name, points, looks, index)


def is_drawn(name: str) -> bool:
    return re.fullmatch(r"(random|hairpins):[0-9]{1,18}", name) is not None


def make_track(name: str, points_m: Floats, looks: tuple[Look, ...], index: NDArray[np.intp]) -> Track:
    """A track from the points (N, 3) of a closed road in metres, its looks, and the number of each point's
    look."""
    line = Centreline(points_m)
    count = len(line.points_m)
    at = index[np.arange(count) * len(index) // count]
    half_width = np.array([look.half_width_m for look in looks])[at]
    reach = round(WIDTH_SMOOTHING_M / line.step_m)
    padded = np.concatenate([half_width[-reach:], half_width, half_width[:reach]])
    smooth = np.convolve(padded, np.full(2 * reach + 1, 1 / (2 * reach + 1)), mode="valid")
    return Track(name, line, smooth, looks, at)
