"""Errors that a user's input causes, and the count of skipped items.

Every error that a user's files, flags or network can cause derives from `UserError`. A command prints it in one
line and ends with exit code 1 (`UsageError`: 2). Any other exception is a bug and keeps its traceback.

    UserError
    ├── UsageError       (common)     flags that contradict each other, or an invalid value of a flag
    ├── StoreError       (common)     an object store that does not answer, or refuses
    ├── ClusterError     (common)     a Ray cluster that cannot be reached, or cannot run the toolkit
    ├── LogError         (recorder)   a log that is missing, damaged, unfinished or of another program
    ├── RecordingError   (recorder)   a recording that cannot be imported
    ├── ListenError      (recorder)   a port that is taken or forbidden
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
_MAX_ERROR_CHARACTERS: Final = 200


def printable(text: str) -> str:
    """Escape the characters of untrusted text that would move the cursor or break the line."""
    safe = text.encode("utf-8", "backslashreplace").decode("utf-8")
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in safe)


def brief(text: str, max_characters: int = 200) -> str:
    """Untrusted text, shortened and printable, for an error."""
    return printable(text if len(text) <= max_characters else f"{text[:max_characters]}...")


def counted(number: int, noun: str, plural: str = "") -> str:
    """Format a number and its noun: "1 frame", "2,000 frames". `plural` is by default the noun with an s."""
    return f"{number:,} {noun if number == 1 else plural or f'{noun}s'}"


def first_of(names: Sequence[str]) -> str:
    """The first eight names, and the number of the others: "a, b", "a, b, c, d, e, f, g, h and 2 more"."""
    more = f" and {len(names) - _MAX_NAMES:,} more" if len(names) > _MAX_NAMES else ""
    return f"{', '.join(names[:_MAX_NAMES])}{more}"


def decimal(value: float, places: int, *, signed: bool = False) -> str:
    """Format a number with `places` decimals: "6.41"; NaN as "-". From a million on with an exponent ("2.7e+17"):
    the errors of a diverged training would fill the line."""
    if math.isnan(value):
        return "-"
    sign = "+" if signed else ""
    return f"{value:{sign}.1e}" if abs(value) >= _MAX_WRITTEN_OUT else f"{value:{sign}.{places}f}"


def did_you_mean(name: str, names: Iterable[str], before: str = "") -> str:
    """A hint such as "did you mean lake?", after `before`, if one of `names` resembles `name`; else ""."""
    near = difflib.get_close_matches(name, list(names), n=1)
    return f"{before}did you mean {near[0]}?" if near else ""


class UserError(Exception):
    """An error that the user can fix. Its text is one line: which file, what is wrong, and the next command."""


class UsageError(UserError):
    """Flags contradict each other, or a flag has an invalid value. If a log, track or run does not exist, the
    error is a UserError."""


class StoreError(UserError):
    """The object store does not answer, or refuses the request."""


class NoSuchObjectError(StoreError):
    """The object does not exist, or may not be read."""


class ObjectExistsError(StoreError):
    """The object already exists."""


class ObjectChangedError(StoreError):
    """The object was replaced while it was read, or by another machine."""


def as_user_error(place: object, error: Exception) -> UserError:
    """Convert any error about one of several places to a one-line UserError, so that the others can still be
    shown. Raises a MemoryError again: it concerns all places."""
    if isinstance(error, MemoryError):
        raise error
    if isinstance(error, UserError):
        return error
    why = f"{type(error).__name__} {' '.join(str(error).split())[:_MAX_ERROR_CHARACTERS]}".rstrip()
    return UserError(f"{place}: cannot be read ({why})")


class Skipped:
    """The number of skipped items by reason, and the first names for each reason.

    A command that has skipped something prints `lines()` to stderr and ends with exit code 3.
    """

    def __init__(self, on_added: Callable[[str, str], object] | None = None) -> None:
        """`on_added` is called with the reason and name of every item, also if the name is not kept."""
        self._on_added = on_added
        self._counts: Counter[str] = Counter()
        self._kept: list[tuple[str, str]] = []

    def add(self, reason: str, name: str) -> None:
        """Count an item. Line ends, and bytes that are not UTF-8, are escaped in its name."""
        self._counts[reason] += 1
        name = printable(name)
        if self._counts[reason] <= MAX_KEPT_NAMES:
            self._kept.append((reason, name))
        if self._on_added is not None:
            self._on_added(reason, name)

    def __len__(self) -> int:
        return self._counts.total()

    def __iter__(self) -> Iterator[tuple[str, str]]:
        """Yield (reason, name) for the first `MAX_KEPT_NAMES` items of each reason, in the order of `add`."""
        return iter(self._kept)

    @property
    def counts(self) -> Counter[str]:
        return Counter(self._counts)

    def lines(self, max_names: int = _MAX_NAMES) -> list[str]:
        """One line for each reason, with the count and the first `max_names` names: "pictures without a row: 1
        (7.jpg)". The reason is a plural, so the count follows it."""
        result = []
        for reason, count in self._counts.items():
            names = itertools.islice((name for other, name in self._kept if other == reason), max_names)
            more = f", and {count - max_names:,} more" if count > max_names else ""
            result.append(f"{reason}: {count:,} ({', '.join(names)}{more})")
        return result

    def error_suffix(self) -> str:
        """The end of an error about an empty result: "; " and the line, for each reason."""
        return "".join(f"; {line}" for line in self.lines(max_names=3))
