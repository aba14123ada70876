"""The result of an import: the log, and everything that was left out of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from common import Skipped
from common.errors import MAX_KEPT_NAMES
from recorder.log.writer import LogWriter


@dataclass(frozen=True)
class Imported:
    path: Path
    rows: int
    pictures: int
    skipped: Skipped
    notices: Sequence[str] = ()  # what a person should know of what is in it


class SkippedEvents:
    """Counts what an import leaves out, and makes an event in its log of each as it comes.

    What is left out before the first row waits for it, and is only counted where a thousand of its kind wait.
    """

    def __init__(self) -> None:
        self.skipped = Skipped(self._added)
        self._writer: LogWriter | None = None
        self._time_ns = 0

    def at(self, writer: LogWriter, time_ns: int) -> None:
        """Give the events that follow the time of this row, to which they belong or after which they come."""
        is_first = self._writer is None
        self._writer, self._time_ns = writer, time_ns
        if is_first:
            for reason, name in self.skipped:
                self._added(reason, name)
            for reason, count in self.skipped.counts.items():
                if count > MAX_KEPT_NAMES:
                    self._added(reason, f"and {count - MAX_KEPT_NAMES:,} more")

    def _added(self, reason: str, name: str) -> None:
        if self._writer is not None:
            self._writer.event(self._time_ns, f"skipped {reason}: {name}", "WARNING", "recorder")
