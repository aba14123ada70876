"""Statistics of a dataset's features: of each episode, and of all episodes together.

As in lerobot's `datasets/compute_stats.py`: images are shares of 255, with one number a channel, from pictures
spread over the episode. A dataset's quantiles are the means of its episodes' quantiles, weighted by their counts.
LeRobot estimates an episode's quantiles from histograms; here they are exact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

QUANTILES: Final = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
MIN_PICTURES: Final = 10
PICTURE_SHARE: Final = 0.1
"""The largest sampled share of an episode's pictures. Decoding takes most of an export's time. LeRobot samples N
** 0.75 of them, and at least 100."""

Values = NDArray[np.float64]
Statistics = dict[str, Values]
"""By name (min, max, mean, std, count, q01 ...): an array of the feature's shape; `count` has one number."""


def sampled(count: int) -> NDArray[np.int64]:
    """The positions of the sampled pictures in an episode of `count`."""
    wanted = min(int(count**0.75), round(count * PICTURE_SHARE))
    chosen = np.linspace(0, count - 1, max(min(MIN_PICTURES, count), wanted))
    return np.unique(np.rint(chosen).astype(np.int64))


def number_statistics(values: NDArray[np.number]) -> Statistics:
    """Statistics of numbers (N, width), or (N,) for one a frame; N > 0."""
    columns = values.reshape(len(values), -1).astype(np.float64)
    return {
        "min": columns.min(axis=0),
        "max": columns.max(axis=0),
        "mean": columns.mean(axis=0),
        "std": columns.std(axis=0),
        "count": np.array([len(columns)], np.float64),
        **dict(zip(QUANTILES, np.quantile(columns, list(QUANTILES.values()), axis=0), strict=True)),
    }


class PictureStatistics:
    """Collects statistics of pictures: 256 counts for each channel."""

    def __init__(self) -> None:
        self.count = 0
        self._counts = np.zeros((3, 256), np.int64)  # red, green, blue

    def add(self, bgr: NDArray[np.uint8]) -> None:
        self.count += 1
        for channel in range(3):
            counts = cv2.calcHist([bgr], [channel], None, [256], [0, 256])
            self._counts[2 - channel] += counts.ravel().astype(np.int64)

    def statistics(self) -> Statistics:
        """Statistics of the pictures until now, at least one; each of shape (3, 1, 1)."""
        level = np.arange(256) / 255
        share = self._counts / self._counts.sum(axis=1, keepdims=True)
        below = np.cumsum(share, axis=1)
        mean = share @ level
        channels = {
            "min": level[np.argmax(self._counts > 0, axis=1)],
            "max": level[255 - np.argmax(self._counts[:, ::-1] > 0, axis=1)],
            "mean": mean,
            "std": np.sqrt(np.maximum(share @ level**2 - mean**2, 0.0)),
            # a rounding error must not miss the first level that just reaches a share
            **{
                name: level[np.argmax(below >= share_below - 1e-12, axis=1)]
                for name, share_below in QUANTILES.items()
            },
        }
        shaped = {name: values.reshape(3, 1, 1) for name, values in channels.items()}
        return shaped | {"count": np.array([self.count], np.float64)}


def combined(episodes: Sequence[Mapping[str, Statistics]]) -> dict[str, Statistics]:
    """The statistics of all episodes of a dataset together; there is at least one episode."""
    return {feature: _combined([episode[feature] for episode in episodes]) for feature in episodes[0]}


def _combined(episodes: Sequence[Statistics]) -> Statistics:
    values = {name: np.stack([measured[name] for measured in episodes]) for name in episodes[0]}
    weights = values["count"][:, 0]
    mean = np.average(values["mean"], axis=0, weights=weights)
    square = np.average(values["std"] ** 2 + values["mean"] ** 2, axis=0, weights=weights)
    return {
        "min": values["min"].min(axis=0),
        "max": values["max"].max(axis=0),
        "mean": mean,
        "std": np.sqrt(np.maximum(square - mean**2, 0.0)),
        "count": values["count"].sum(axis=0),
        **{name: np.average(values[name], axis=0, weights=weights) for name in QUANTILES},
    }


def as_json(statistics: Mapping[str, Statistics]) -> dict[str, dict[str, list[object]]]:
    """Statistics as lists of numbers; counts are whole numbers."""
    return {
        feature: {
            name: values.astype(np.int64).tolist() if name == "count" else values.tolist()
            for name, values in measured.items()
        }
        for feature, measured in statistics.items()
    }
