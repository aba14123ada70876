"""What goes wrong through a user's input, and what was left out because of it.

Every error that a user's files, flags or network can cause derives from `UserError`; a command prints it in
one line and ends with exit code 1. Anything else that escapes is a bug and keeps its traceback.

    UserError
    ├── LogError         (recorder)   a log that is missing, damaged, unfinished or of another program
    ├── RecordingError   (recorder)   a recording that cannot be imported
    ├── ListenError      (recorder)   a port that is taken, or may not be listened on
    ├── DatasetError     (dataset)    an index that is missing, empty or older than its logs
    ├── RunError         (model)      a run folder that is missing, incomplete or of another version
    └── DriveError       (drive)      a drive that cannot start
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator


def shown(text: str) -> str:
    """Text of somebody else's file without what moves a cursor or breaks a line: such characters are escaped."""
    safe = text.encode("utf-8", "backslashreplace").decode("utf-8")
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in safe)


class UserError(Exception):
    """One clear line for a person: which file, what was expected, and the next command to try."""


class Skipped:
    """What was left out, by reason: counted whole, and named one by one.

    A command that finishes with something skipped ends with exit code 3 and prints `lines()` to stderr.
    """

    def __init__(self) -> None:
        self._items: list[tuple[str, str]] = []

    def add(self, reason: str, name: str) -> None:
        """A name may come from any file system: what is not UTF-8 in it is escaped, as are line ends."""
        self._items.append((reason, shown(name)))

    def __len__(self) -> int:
        return len(self._items)

    def __iter__(self) -> Iterator[tuple[str, str]]:
        """Every (reason, name), in the order in which it was met."""
        return iter(self._items)

    @property
    def counts(self) -> Counter[str]:
        return Counter(reason for reason, _ in self._items)

    def lines(self, most_names: int = 8) -> list[str]:
        """One line a reason: its count and the first `most_names` names."""
        result = []
        for reason, count in self.counts.items():
            names = [name for other, name in self._items if other == reason]
            more = f", and {count - most_names} more" if count > most_names else ""
            result.append(f"{count} {reason}: {', '.join(names[:most_names])}{more}")
        return result
