"""Unusable telemetries as events of a log: the first of each kind, and the number of the others."""

from __future__ import annotations

import re
from collections import Counter
from typing import Final

MAX_OF_EACH: Final = 5  # events of each kind; more telemetries are only counted

_PREFIX: Final = "bad telemetry: "
_MORE: Final = re.compile(r" \(([0-9][0-9,]{0,25}) more\)$")


class BadTelemetry:
    """Counts unusable telemetries by kind (`TelemetryError.kind`). There are few kinds, whatever clients send."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def take(self, kind: str, reason: str) -> str | None:
        """Count a telemetry, and return its event; None after `MAX_OF_EACH` of its kind."""
        self.counts[kind] += 1
        return f"{_PREFIX}{reason}" if self.counts[kind] <= MAX_OF_EACH else None

    def remaining(self) -> list[str]:
        """The events at the end of a log, for telemetries that were only counted."""
        return [
            f"{_PREFIX}{kind} ({count - MAX_OF_EACH:,} more)"
            for kind, count in self.counts.items()
            if count > MAX_OF_EACH
        ]


def read_event(message: str) -> tuple[str, int]:
    """The kind in an event's text, and the number of telemetries that it stands for; 0 for other events."""
    if not message.startswith(_PREFIX):
        return message, 0
    reason = message.removeprefix(_PREFIX)
    more = _MORE.search(reason)
    return reason.partition(" (")[0], 1 if more is None else int(more[1].replace(",", ""))
