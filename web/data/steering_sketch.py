"""The steering of a session as a small SVG: its course, and a histogram."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from dataset.steering_bins import bin_of
from recorder.rows.row_quality import Values

WIDTH, HEIGHT = 240, 40
_ALONG: Final = 170  # of the width; the histogram has the rest
_GAP: Final = 10
_BINS: Final = 25  # as the index has them by default
_LINE, _BARS, _AXIS = "#4a90d9", "#c77d1e", "#8884"  # distinct from each other, on a light and on a dark page


def steering_sketch(steering: Values) -> bytes:
    """The sketch of the rows' steering (N,), without invalid values. Right is up, and right in the bars."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}">',
        f'<path d="M0 {HEIGHT / 2}H{_ALONG}" stroke="{_AXIS}"/>',
        f'<path d="{_along(steering)}" stroke="{_LINE}" stroke-width="1" fill="none"/>',
        f'<path d="{_bars(steering)}" fill="{_BARS}"/>',
        "</svg>",
    ]
    return "".join(parts).encode()


def _along(steering: Values) -> str:
    """A stroke from the lowest to the highest steering at each point across."""
    edges = np.linspace(0, len(steering), min(_ALONG, max(len(steering), 1)) + 1).astype(int)
    step = _ALONG / (len(edges) - 1)
    strokes = []
    for number, (first, last) in enumerate(pairwise(edges.tolist())):
        values = steering[first:last]
        values = values[np.abs(values) <= 1]
        if len(values):
            top, bottom = (_y(value) for value in (values.max(), values.min()))
            strokes.append(f"M{(number + 0.5) * step:.1f} {top - 0.5:.1f}V{bottom + 0.5:.1f}")
    return "".join(strokes)


def _y(value: float) -> float:
    return float(HEIGHT / 2 - value * (HEIGHT / 2 - 2))


def _bars(steering: Values) -> str:
    values = steering[np.abs(steering) <= 1]
    counts = np.bincount(bin_of(values, _BINS), minlength=_BINS)
    if not counts.any():
        return ""
    left, width = _ALONG + _GAP, (WIDTH - _ALONG - _GAP) / _BINS
    # square roots: most people steer straight ahead most of the time
    heights = np.sqrt(counts / counts.max()) * (HEIGHT - 2)
    return "".join(
        f"M{left + number * width:.1f} {HEIGHT}v{-height:.1f}h{width * 0.8:.1f}v{height:.1f}z"
        for number, height in enumerate(heights.tolist())
        if height
    )
