"""Roads as lists of stretches, each with a length, a turn, a grade and a look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simulator.roads.centreline import Floats

STEP_M = 0.25
TURN_SMOOTHING_M = 3.0  # smooths the beginnings of bends, like the clothoids of real roads
GRADE_SMOOTHING_M = 9.0  # smooths crests and dips

Surface = Literal["asphalt", "worn", "cobbles"]
EdgeKind = Literal["kerb", "striped", "dirt", "line", "wall", "grass"]


@dataclass(frozen=True)
class Edge:
    """The edge of a road on one side.

    ``kerb``: yellow double line, then a pale kerb. ``striped``: yellow line, then a red and white kerb.
    ``dirt``: bare earth. ``line``: a white line, then grass. ``wall``: a bridge's dark parapet. ``grass``:
    only grass.
    """

    kind: EdgeKind
    bank_m: float = 0.0  # height of the ground beyond the verge above the road (negative: below the road)
    props_per_100m: float = 24.0  # trees, bushes and boulders


@dataclass(frozen=True)
class Look:
    surface: Surface
    left: Edge
    right: Edge
    half_width_m: float
    dashed: bool = False  # a dashed white line in the middle
    jungle: bool = False  # dark woods and rock; otherwise meadows and pines
    light: float = 1.0  # exposure; 1: full sun
    shade: float = 0.0  # 0..1, share of the road in the shadow of branches


@dataclass(frozen=True)
class Stretch:
    """A part of a road with constant curvature and grade."""

    length_m: float
    turn_deg: float  # over the whole length, positive to the left
    grade: float  # rise over run
    look: Look


def trace(stretches: Sequence[Stretch]) -> tuple[Floats, NDArray[np.intp]]:
    """The points (N, 3) of a closed road in metres, 0.25 m apart, and the number of each point's stretch (N,).

    The turns must add up to 360 or -360 degrees. To close the loop, the lengths of the straights are changed as
    little as possible, and all grades by the same amount.
    """
    turns = np.radians([s.turn_deg for s in stretches])
    if abs(abs(turns.sum()) - 2 * np.pi) > 1e-6:
        raise ValueError(f"the turns of a closed road add up to 360 degrees, not {np.degrees(turns.sum()):.1f}")
    lengths = _close([s.length_m for s in stretches], turns)
    ends = np.cumsum(lengths)
    count = round(ends[-1] / STEP_M)
    step = ends[-1] / count
    arc = (np.arange(count) + 0.5) * step
    index = np.minimum(np.searchsorted(ends, arc), len(stretches) - 1)
    curvature = _smooth((turns / lengths)[index], TURN_SMOOTHING_M / step)
    heading = np.cumsum(curvature) * step
    grade = np.array([s.grade for s in stretches])[index]
    steps = np.stack([np.cos(heading), np.sin(heading), _smooth(grade, GRADE_SMOOTHING_M / step)], axis=1) * step
    # Smoothing has opened the loop again by about a metre: this is distributed evenly over all steps.
    return np.cumsum(steps - steps.mean(axis=0), axis=0), index


def _close(lengths_m: Sequence[float], turns_rad: Floats) -> Floats:
    """The lengths, with those of the straights changed (least squares), so that the end meets the start."""
    lengths = np.array(lengths_m, dtype=np.float64)
    before = np.concatenate([[0.0], np.cumsum(turns_rad)[:-1]])
    middle = before + turns_rad / 2
    # The chord of an arc is its length * sin(t/2) / (t/2), in the direction at its middle.
    chords = np.stack([np.cos(middle), np.sin(middle)]) * np.sinc(turns_rad / (2 * np.pi))
    straight = turns_rad == 0.0
    lengths[straight] -= np.linalg.pinv(chords[:, straight]) @ (chords @ lengths)
    if lengths.min() < 5.0:
        raise ValueError("this road cannot be closed by changing its straights")
    return lengths


def _smooth(values: Floats, sigma: float) -> Floats:
    """Gaussian smoothing around a closed loop, ``sigma`` in samples."""
    frequency = np.fft.rfftfreq(len(values))
    spectrum = np.fft.rfft(values) * np.exp(-2 * (np.pi * frequency * sigma) ** 2)
    smooth: Floats = np.fft.irfft(spectrum, len(values))
    return smooth
