"""Whether a driving error is small enough to drive, and how sure that is (docs/studies/which-number.md).

66 networks predicted recordings that none had learnt from, and drove a quarter lap at 15 mph of lake, mountain and
five random roads. Those that needed no intervention on any of them stayed on the road. The study is of built-in
roads alone, its networks are alike (15 recipes of a few seeds), and the edges were chosen by the same networks:
on other roads, less is sure than an interval says.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final, Literal

Hand = Literal["keys", "smooth"]
"""How the measured rows were steered. Keys are pressed at moments that no network can foresee, so that the same
network has a larger error on their rows."""


@dataclass(frozen=True)
class Band:
    """The networks of the study with an error up to `below`, and from the band before on."""

    below: float
    networks: int
    stayed: int  # on the road

    @property
    def share(self) -> float:
        return self.stayed / self.networks

    @property
    def interval(self) -> tuple[float, float]:
        return wilson_interval(self.stayed, self.networks)


EDGES: Final[dict[Hand, tuple[float, float]]] = {"keys": (1.05, 1.1), "smooth": (0.55, 0.65)}
"""Below the first one networks drive, from the second one on they do not."""

STUDY: Final[dict[Hand, tuple[Band, Band, Band]]] = {
    "keys": (Band(1.05, 28, 28), Band(1.1, 24, 15), Band(math.inf, 14, 0)),
    "smooth": (Band(0.55, 30, 30), Band(0.65, 21, 13), Band(math.inf, 15, 0)),
}
"""`python studies/which_number_report.py studies/which_number.parquet FOLDER` prints these counts."""


@dataclass(frozen=True)
class Drivable:
    """Whether a network drives the built-in roads, by its driving error."""

    is_enough: bool | None  # None where that is open
    why: str
    band: Band | None = None  # None where recordings of keys and smooth ones give different answers


def drivable(driving_error: float, hands: Collection[Hand], *, is_unseen: bool) -> Drivable:
    """Judge an error on rows that were steered so; of several hands, or unknown ones, only what holds for all.

    Without `is_unseen`, the rows are of drives that the network has learnt other rows of. Errors are smaller
    there: one that is too large surely is, of one that is small enough it stays open.
    """
    bands = {hand: _band(driving_error, hand) for hand in (hands or STUDY)}
    if len({STUDY[hand].index(band) for hand, band in bands.items()}) > 1:
        return Drivable(
            None, "errors on rows of keys are larger than on smooth ones, and these are of both, or unknown"
        )
    band = min(bands.values(), key=lambda band: band.below)
    low, high = band.interval
    share = f"{band.stayed} of {band.networks} networks with such an error stayed on built-in roads"
    why = f"{share} ({100 * low:.0f} to {100 * high:.0f} %)"
    if band.stayed == band.networks and not is_unseen:
        return Drivable(None, f"{why}, but their errors are on drives new to them", band)
    return Drivable(None if 0 < band.stayed < band.networks else bool(band.stayed), why, band)


def _band(driving_error: float, hand: Hand) -> Band:
    return next((band for band in STUDY[hand] if driving_error < band.below), STUDY[hand][-1])


def wilson_interval(count: int, total: int, z: float = 1.96) -> tuple[float, float]:
    """The 95 % interval of a share, `count` of `of` (E. B. Wilson 1927), within 0..1 also of all or none."""
    share, square = count / total, z * z / total
    middle = (share + square / 2) / (1 + square)
    half = z / (1 + square) * math.sqrt(share * (1 - share) / total + square / (4 * total))
    return max(0.0, middle - half), min(1.0, middle + half)
