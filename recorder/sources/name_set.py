"""Which names were there already, in little memory: a day's drive names a million pictures."""

from __future__ import annotations

from array import array
from collections.abc import Hashable
from typing import Final

_FIRST_SLOTS: Final = 1 << 8  # always a power of two


class NameSet:
    """A set that keeps 64 bits of each member, at 12 to 24 bytes: it can be asked, but not listed.

    Two of a million names are taken for the same one with a probability of 3e-8.
    """

    def __init__(self) -> None:
        self._slots = array("q", bytes(8 * _FIRST_SLOTS))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def __contains__(self, name: Hashable) -> bool:
        return self._slots[self._slot(hash(name) or 1)] != 0

    def add(self, name: Hashable) -> bool:
        """Whether it was not there yet."""
        return self._add(hash(name) or 1)  # 0 is an empty slot

    def update(self, other: NameSet) -> None:
        """Add all that is in `other`."""
        for key in other._slots:
            if key:
                self._add(key)

    def _add(self, key: int) -> bool:
        at = self._slot(key)
        if self._slots[at]:
            return False
        self._slots[at] = key
        self._count += 1
        if 3 * self._count > 2 * len(self._slots):
            held = self._slots
            self._slots = array("q", bytes(16 * len(held)))
            for earlier in held:
                if earlier:
                    self._slots[self._slot(earlier)] = earlier
        return True

    def _slot(self, key: int) -> int:
        """Where a key is, or the free slot where it belongs."""
        slots = self._slots
        mask = len(slots) - 1
        at = key & mask
        while slots[at] not in (0, key):
            at = (at + 1) & mask
        return at
