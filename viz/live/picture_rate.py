"""A limit on the rate of pictures: a drive that is faster than real time must not drown its viewer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Final

from recorder.topics import PICTURE_TOPICS
from viz.live.live_messages import LiveMessage

PICTURES_PER_S: Final = 30.0
"""The limit for each camera, in real time."""
THINNED: Final = f"pictures not shown, of more than {PICTURES_PER_S:g} a second (the log has them)"

_SAVED_UP_S: Final = 1.0  # a log grows in bursts


class PictureRate:
    """Lets through as many pictures of each topic as time has passed for, evenly chosen, always the newest."""

    def __init__(self, now_s: float) -> None:
        self._now_s = now_s
        self._allowed: dict[str, float] = {}
        self._last_s: dict[str, float] = {}

    def tick(self, now_s: float) -> None:
        """Tell the time: seconds of a clock that does not go back."""
        self._now_s = now_s

    def thin(self, messages: Sequence[LiveMessage]) -> tuple[list[LiveMessage], list[LiveMessage]]:
        """Split messages into those to show and those to drop, both in their order."""
        counts = Counter(message.topic for message in messages)
        keep = {topic: self._take(topic, count) for topic, count in counts.items() if topic in PICTURE_TOPICS}
        shown: list[LiveMessage] = []
        thinned: list[LiveMessage] = []
        numbers: dict[str, int] = {}
        for message in messages:
            number = numbers[message.topic] = numbers.get(message.topic, 0) + 1
            is_shown = message.topic not in keep or _is_kept(number, counts[message.topic], keep[message.topic])
            (shown if is_shown else thinned).append(message)
        return shown, thinned

    def _take(self, topic: str, count: int) -> int:
        passed_s = self._now_s - self._last_s.get(topic, self._now_s - _SAVED_UP_S)
        self._last_s[topic] = self._now_s
        most = PICTURES_PER_S * _SAVED_UP_S
        allowed = min(self._allowed.get(topic, 0.0) + PICTURES_PER_S * passed_s, most)
        taken = min(count, int(allowed))
        self._allowed[topic] = allowed - taken
        return taken


def _is_kept(number: int, count: int, kept: int) -> bool:
    """True if the picture of this number (1..count) is one of `kept`, evenly spread, the last one among them."""
    return number * kept // count > (number - 1) * kept // count
