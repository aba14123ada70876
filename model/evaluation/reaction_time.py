"""How much later than a network a person steers.

A network answers a picture at once, a person after a reaction time. Therefore the answers of a good network
correlate better with the steering recorded a little later than with that of the same moment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from dataset.frames.distinct_rows import by_session
from model.metrics import errors

DELAYS_S: Final = tuple(round(0.05 * step, 2) for step in range(13))
"""Up to 0.6 s: published recordings of people have their maximum at 0.1 to 0.3 s."""

MIN_KNOWN: Final = 0.5
"""The share of frames whose later steering must be known."""

_PAUSE_NS: Final = 1_000_000_000
"""A longer step between frames is a pause."""


@dataclass(frozen=True)
class ReactionTime:
    """The delay that most raises the correlation between a network's answers and the recorded steering."""

    delay_s: float  # mean over frames
    correlation: float  # -1..1, at this delay
    at_once: float  # the correlation of the same frames without a delay


def reaction_time(frames: pa.Table) -> ReactionTime | None:
    """The reaction time in the frames of an evaluation (columns session, log_time_ns, recorded, predicted).

    None if the answers or the steering are constant, or if the correlation still grows at the largest delay.
    """
    sessions = [part.sort_by("log_time_ns") for _, part in by_session(frames)]
    predicted, recorded = (
        np.concatenate([part[name].to_numpy() for part in sessions]) for name in ("predicted", "recorded")
    )
    delays = []
    for delay_s in DELAYS_S:
        later, after_s = np.concatenate([_steering_later(part, delay_s) for part in sessions], axis=1)
        is_known = np.isfinite(later)
        if is_known.mean() < MIN_KNOWN:
            break
        if delay_s and not after_s[is_known].any():
            continue  # shorter than half a step: fewer frames than at 0, but none later
        # the last frames before a pause have no later steering: `at_once` leaves them out, too
        correlation, at_once = (
            errors(predicted[is_known], steering[is_known]).correlation for steering in (later, recorded)
        )
        delays.append(ReactionTime(float(after_s[is_known].mean()), correlation, at_once))
    defined = [delay for delay in delays if not math.isnan(delay.correlation - delay.at_once)]
    best = max(defined, key=lambda delay: delay.correlation - delay.at_once, default=None)
    return None if best is not None and 0 < best.delay_s == defined[-1].delay_s else best


def _steering_later(frames: pa.Table, delay_s: float) -> NDArray[np.float64]:
    """For each frame of a session, the steering of the frame nearest to `delay_s` seconds later, and that frame's
    delay in s: (2, N). NaN beyond the next pause.

    It is not interpolated between frames: at delays other than 0, it would have less noise than at 0.
    """
    time_ns, recorded = frames["log_time_ns"].to_numpy(), frames["recorded"].to_numpy()
    later_ns = time_ns + round(delay_s * 1e9)
    nearest = np.searchsorted(time_ns[:-1] + np.diff(time_ns) // 2, later_ns)
    last_ns = np.append(time_ns[:-1][np.diff(time_ns) > _PAUSE_NS], time_ns[-1])  # of each drive
    is_known = later_ns <= last_ns[np.searchsorted(last_ns, time_ns)]
    return np.where(is_known, [recorded[nearest], (time_ns[nearest] - time_ns) / 1e9], np.nan)
