"""Steering as small SVGs: along a session, and as histograms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dataset.steering_bins import bin_of
from recorder.rows.row_quality import Values

WIDTH, HEIGHT = 240, 40
_ALONG: Final = 170  # the curve's part of the width
_GAP: Final = 10
_LINE, _BARS, _AXIS = "#4a90d9", "#c77d1e", "#8884"  # readable on light and dark pages


def steering_sketch(steering: Values, bins: int) -> bytes:
    """A curve and a histogram of steering (N,) without its invalid values. Right is up in the curve, and right in
    the histogram."""
    values = steering[np.abs(steering) <= 1]
    heights = root_heights(np.bincount(bin_of(values, bins), minlength=bins), HEIGHT - 2)
    parts = [
        f'<path d="M0 {HEIGHT / 2}H{_ALONG}" stroke="{_AXIS}"/>',
        f'<path d="{_along(steering)}" stroke="{_LINE}" stroke-width="1" fill="none"/>',
        f'<path d="{bars(heights, _ALONG + _GAP, WIDTH, HEIGHT)}" fill="{_BARS}"/>',
    ]
    return svg(WIDTH, HEIGHT, parts)


def svg(width: int, height: int, parts: Iterable[str], attributes: str = "") -> bytes:
    """A picture of these elements."""
    start = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}"{attributes}>'
    return f"{start}{''.join(parts)}</svg>".encode()


def root_heights(counts: NDArray[np.int64], height: float) -> list[float]:
    """Heights by the square roots of counts, because most people steer straight ahead most of the time."""
    shares: list[float] = (height * np.sqrt(counts / max(1, counts.max()))).tolist()
    return shares


def bars(heights: Sequence[float], left: float, right: float, bottom: float, share: float = 0.8) -> str:
    """The path of bars between two edges. A bar fills a `share` of its place."""
    step = (right - left) / max(1, len(heights))
    inset, width = step * (1 - share) / 2, step * share
    return "".join(
        f"M{left + number * step + inset:.1f} {bottom}v{-height:.1f}h{width:.1f}v{height:.1f}z"
        for number, height in enumerate(heights)
        if height
    )


def _along(steering: Values) -> str:
    """At each point across, a stroke from the lowest to the highest steering."""
    edges = np.linspace(0, len(steering), min(_ALONG, max(len(steering), 1)) + 1).astype(int)
    step = _ALONG / (len(edges) - 1)
    half = HEIGHT / 2
    strokes = []
    for number, (first, last) in enumerate(pairwise(edges.tolist())):
        values = steering[first:last]
        values = values[np.abs(values) <= 1]
        if len(values):
            top, bottom = (half - float(value) * (half - 2) for value in (values.max(), values.min()))
            strokes.append(f"M{(number + 0.5) * step:.1f} {top - 0.5:.1f}V{bottom + 0.5:.1f}")
    return "".join(strokes)
