"""The steering filter: smooths the network's steering and limits its rate. Both are off by default."""

from __future__ import annotations

import math


class SteeringFilter:
    """Exponential smoothing and a rate limit for steering in -1..1; it starts with the wheels straight.

    `smooth_s` is the time constant of the smoothing (63 % of a jump after one, 95 % after three), `max_per_s` the
    largest change in a second; 0 switches each off. The filter is in time, not in messages: 10 and 50 messages a
    second give the same steering over time.
    """

    def __init__(self, smooth_s: float = 0.0, max_per_s: float = 0.0) -> None:
        self._smooth_s = smooth_s
        self._max_per_s = max_per_s
        self._sent = 0.0
        self._time_s = 0.0

    def apply(self, time_s: float, wanted: float) -> float:
        """The steering to send at `time_s`, which must not go back."""
        passed_s = time_s - self._time_s
        change = wanted - self._sent
        if self._smooth_s:
            change *= -math.expm1(-passed_s / self._smooth_s)
        if self._max_per_s:
            max_change = self._max_per_s * passed_s
            change = min(max(change, -max_change), max_change)
        # without a limit, exactly `wanted`: adding the difference would round
        sent = wanted if change == wanted - self._sent else self._sent + change
        self.override(time_s, sent)
        return sent

    def override(self, time_s: float, sent: float) -> None:
        """Continue from the steering `sent`, which another driver has sent."""
        self._sent, self._time_s = sent, time_s
