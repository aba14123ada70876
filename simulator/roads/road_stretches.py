"""Roads drawn as a list of stretches: so long, turning so much, climbing so much, looking like this."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

STEP_M = 0.25
TURN_SMOOTHING_M = 3.0  # how gently a bend begins: a stand-in for the clothoids of real roads
GRADE_SMOOTHING_M = 9.0  # the same for crests and dips

Surface = Literal["asphalt", "worn", "cobbles"]
EdgeKind = Literal["kerb", "striped", "dirt", "line", "wall", "grass"]


@dataclass(frozen=True)
class Edge:
    """The edge of a road on one side.

    ``kerb``: yellow double line, then a pale kerb. ``striped``: yellow line, then a red and white kerb.
    ``dirt``: bare earth. ``line``: a white line, then grass. ``wall``: a bridge's dark parapet. ``grass``:
    nothing but grass.
    """

    kind: EdgeKind
    bank_m: float = 0.0  # how far the ground beyond the verge stands above the road (below it: negative)
    props_per_100m: float = 24.0  # trees, bushes and boulders


@dataclass(frozen=True)
class Look:
    """All that a stretch of road looks like."""

    surface: Surface
    left: Edge
    right: Edge
    half_width_m: float
    dashed: bool = False  # a dashed white line in the middle
    jungle: bool = False  # dark woods and rock; otherwise meadows and pines
    light: float = 1.0  # exposure, 1 is full sun
    shade: float = 0.0  # 0..1, how much of the road lies in the shadow of branches


@dataclass(frozen=True)
class Stretch:
    """A piece of road of constant curvature and grade."""

    length_m: float
    turn_deg: float  # over its whole length, positive to the left
    grade: float  # rise over run
    look: Look


def trace(stretches: Sequence[Stretch]) -> tuple[Floats, NDArray[np.intp]]:
    """Draw a closed road: its points (N, 3) in metres, 0.25 m apart, and the number of each point's stretch.

    The turns must add up to 360 degrees either way. What the lengths and grades lack to close the loop is
    spread: over the straights, changing their lengths as little as possible, and evenly over the grades.
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
    # Smoothing has opened the loop again by a metre or so: take an equal share of it off every step.
    return np.cumsum(steps - steps.mean(axis=0), axis=0), index


def _close(lengths_m: Sequence[float], turns_rad: Floats) -> Floats:
    """The same lengths with those of the straights changed, least squares, so that the end meets the start."""
    lengths = np.array(lengths_m, dtype=np.float64)
    before = np.concatenate([[0.0], np.cumsum(turns_rad)[:-1]])
    middle = before + turns_rad / 2
    # The chord of an arc is its length times sin(t/2) / (t/2), in the direction of its middle.
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
