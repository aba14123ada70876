"""Whether a driving error is small enough to drive, and how certain that is (docs/studies/which-number.md).

82 networks predicted recordings that none of them had learnt from. Then each drove a quarter lap at 15 mph on
lake, mountain and five random roads. It stayed on the road if it needed no intervention on any of them. The
intervals are too narrow for other roads: all roads are built in, the networks are alike, and they also gave the
edges.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final, Literal

Hand = Literal["keys", "smooth"]
"""How the measured rows were steered. No network can foresee the moment of a key press, so the same network has a
larger error on rows of keys."""


@dataclass(frozen=True)
class Band:
    """The networks of the study with an error below `below` and not in an earlier band."""

    below: float
    networks: int
    stayed: int  # networks that stayed on the road

    @property
    def share(self) -> float:
        return self.stayed / self.networks


EDGES: Final[dict[Hand, tuple[float, float]]] = {"keys": (1.05, 1.1), "smooth": (0.55, 0.7)}
"""Below the first edge, networks drive; from the second edge, they do not."""

STUDY: Final[dict[Hand, tuple[Band, Band, Band]]] = {
    "keys": (Band(1.05, 30, 30), Band(1.1, 29, 19), Band(math.inf, 23, 0)),
    "smooth": (Band(0.55, 32, 32), Band(0.7, 31, 17), Band(math.inf, 19, 0)),
}
"""`python studies/which_number_report.py studies/which_number.parquet FOLDER` prints these counts."""


RECORDINGS: Final = 5
"""The errors in `STUDY` are of this many recordings together. On one recording, they vary too much for the
edges."""

ON_ONE: Final[dict[Hand, tuple[float, float]]] = {"keys": (0.83, 1.43), "smooth": (0.5, 0.86)}
"""The smallest error on a single recording of a network that left the road, and the largest of one that stayed (16
networks, five recordings each)."""


@dataclass(frozen=True)
class Drivable:
    """Whether a network drives the built-in roads, by its driving error."""

    is_enough: bool | None  # None if uncertain
    why: str
    band: Band | None = None  # None if the bands of keys and of smooth steering disagree


def drivable(driving_error: float, hands: Collection[Hand], *, is_unseen: bool, recordings: int) -> Drivable:
    """Judge a driving error on rows that `hands` steered in that many recordings. With several or no hands, the
    results for all must agree.

    Without `is_unseen`, the network has learnt other rows of the same drives, so a small error is uncertain.
    """
    bands = {hand: _band(driving_error, hand) for hand in (hands or STUDY)}
    if len({STUDY[hand].index(band) for hand, band in bands.items()}) > 1:
        return Drivable(
            None, "errors are larger on rows of keys than on smooth ones, and these rows are of both, or unknown"
        )
    band = min(bands.values(), key=lambda band: band.below)
    low, high = wilson_interval(band.stayed, band.networks)
    share = f"{band.stayed} of {band.networks} networks with an error like this stayed on built-in roads"
    why = f"{share} ({100 * low:.0f} to {100 * high:.0f} %)"
    if band.stayed == band.networks and not is_unseen:
        return Drivable(None, f"{why}, but their errors are on drives new to them", band)
    left_from = min(ON_ONE[hand][0] for hand in bands)
    stayed_to = max(ON_ONE[hand][1] for hand in bands)
    if recordings < RECORDINGS and driving_error <= stayed_to:
        one = f"on one recording, networks that stayed on built-in roads had errors up to {stayed_to:.2f}"
        return Drivable(None, f"{one}, those that left from {left_from:.2f} on", band)
    return Drivable(None if 0 < band.stayed < band.networks else bool(band.stayed), why, band)


def _band(driving_error: float, hand: Hand) -> Band:
    return next((band for band in STUDY[hand] if driving_error < band.below), STUDY[hand][-1])


def wilson_interval(count: int, total: int) -> tuple[float, float]:
    """The 95 % interval of the share `count` / `total` (E. B. Wilson 1927), always within 0..1."""
    z = 1.96
    share, square = count / total, z * z / total
    middle = (share + square / 2) / (1 + square)
    half = z / (1 + square) * math.sqrt(share * (1 - share) / total + square / (4 * total))
    return max(0.0, middle - half), min(1.0, middle + half)
