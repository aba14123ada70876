"""Errors that a user's input causes, and the count of what was left out because of it.

Every error that a user's files, flags or network can cause derives from `UserError`; a command prints it in
one line and ends with exit code 1, or 2 for a `UsageError`. Anything else that escapes is a bug and keeps its
traceback.

    UserError
    ├── UsageError       (common)     flags of a command that do not go together, or a value that makes no sense
    ├── StoreError       (common)     a store of objects that does not answer, or refuses
    ├── ClusterError     (common)     a Ray cluster that cannot be reached, or on which nothing of ours can run
    ├── LogError         (recorder)   a log that is missing, damaged, unfinished or of another program
    ├── RecordingError   (recorder)   a recording that cannot be imported
    ├── ListenError      (recorder)   a port that is taken, or may not be listened on
    ├── DatasetError     (dataset)    an index that is missing, empty or older than its logs
    ├── RunError         (model)      a run folder that is missing, incomplete or of another version
    └── DriveError       (drive)      a drive that cannot start
"""

from __future__ import annotations

import difflib
import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final

MAX_KEPT_NAMES: Final = 1000
_MAX_NAMES: Final = 8
_MAX_WRITTEN_OUT: Final = 1e6
_MAX_ERROR_CHARACTERS: Final = 200  # characters


def printable(text: str) -> str:
    """Escape the characters of untrusted text that would move a cursor or break a line."""
    safe = text.encode("utf-8", "backslashreplace").decode("utf-8")
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in safe)


def counted(number: int, noun: str, plural: str = "") -> str:
    """Format a number and its noun: "1 frame", "2,000 frames". `plural` is needed if it is not made by an s."""
    return f"{number:,} {noun if number == 1 else plural or f'{noun}s'}"


def first_of(names: Sequence[str]) -> str:
    """The first eight names, and how many more there are: "a, b", "a, b, c, d, e, f, g, h and 2 more"."""
    more = f" and {len(names) - _MAX_NAMES:,} more" if len(names) > _MAX_NAMES else ""
    return f"{', '.join(names[:_MAX_NAMES])}{more}"


def decimal(value: float, places: int, *, signed: bool = False) -> str:
    """Format a number with so many places, "-" where there is none: "6.41", or "2.7e+17" of a training that ran
    away, whose digits would fill the line."""
    if math.isnan(value):
        return "-"
    sign = "+" if signed else ""
    return f"{value:{sign}.1e}" if abs(value) >= _MAX_WRITTEN_OUT else f"{value:{sign}.{places}f}"


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """A hint if one of `names` is nearly `name`, such as "did you mean lake?"; else ""."""
    near = difflib.get_close_matches(name, list(names), n=1)
    return f"did you mean {near[0]}?" if near else ""


class UserError(Exception):
    """One clear line for a person: which file, what was expected, and the next command to try."""


class UsageError(UserError):
    """Flags of a command that do not go together, or the value of one that makes no sense in itself. The name of a
    log, track or run that does not exist is a UserError."""


class StoreError(UserError):
    """A store that does not answer, or refuses the request."""


class NoSuchObjectError(StoreError):
    """There is no object of this name, or it may not be read."""


class ObjectExistsError(StoreError):
    """Something of this name is there already."""


class ObjectChangedError(StoreError):
    """An object was replaced while it was read."""


def as_user_error(place: object, error: Exception) -> UserError:
    """The error of one of many places that are looked at. Whatever is wrong with one is one line, and the others
    are not lost with it. Raises it where the machine has no memory left, for whatever place."""
    if isinstance(error, MemoryError):
        raise error
    if isinstance(error, UserError):
        return error
    why = f"{type(error).__name__} {' '.join(str(error).split())[:_MAX_ERROR_CHARACTERS]}".rstrip()
    return UserError(f"{place}: cannot be looked at ({why})")


class Skipped:
    """A count of what was left out, by reason; the first names of each reason are kept.

    A command that finishes with something skipped ends with exit code 3 and prints `lines()` to stderr.
    """

    def __init__(self, on_added: Callable[[str, str], object] = lambda reason, name: None) -> None:
        """`on_added` is called with every reason and name as it comes, also those that are not kept."""
        self._on_added = on_added
        self._counts: Counter[str] = Counter()
        self._kept: list[tuple[str, str]] = []

    def add(self, reason: str, name: str) -> None:
        """A name may come from any file system: what is not UTF-8 in it is escaped, as are line ends."""
        self._counts[reason] += 1
        name = printable(name)
        if self._counts[reason] <= MAX_KEPT_NAMES:
            self._kept.append((reason, name))
        self._on_added(reason, name)

    def __len__(self) -> int:
        return self._counts.total()

    def __iter__(self) -> Iterator[tuple[str, str]]:
        """(reason, name) of the first `MAX_KEPT_NAMES` of each reason, in the order in which they were met."""
        return iter(self._kept)

    @property
    def counts(self) -> Counter[str]:
        return Counter(self._counts)

    def lines(self, max_names: int = _MAX_NAMES) -> list[str]:
        """One line a reason, its count and the first `max_names` names: "pictures without a row: 1 (7.jpg)".

        The count comes behind the reason, which is a plural and would not fit "1 row".
        """
        result = []
        for reason, count in self._counts.items():
            names = itertools.islice((name for other, name in self._kept if other == reason), max_names)
            more = f", and {count - max_names:,} more" if count > max_names else ""
            result.append(f"{reason}: {count:,} ({', '.join(names)}{more})")
        return result

    def error_suffix(self) -> str:
        """Explains at the end of an error why nothing was left: "; " and the line of each reason."""
        return "".join(f"; {line}" for line in self.lines(max_names=3))
