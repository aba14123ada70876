"""Memory for batches that is used again: fresh memory, which the system zeroes first, slows a loader by 6 %."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from dataset.preprocess import Image

Allocate = Callable[[tuple[int, ...]], Image]
"""Gives an array of a shape, uint8, its content arbitrary."""


def _plain_memory(shape: tuple[int, ...]) -> Image:
    return np.empty(shape, np.uint8)


class Buffers:
    """Arrays of one shape. Whoever gets one may keep it, or any part of it, for as long as they like."""

    def __init__(self, shape: tuple[int, ...], most: int, allocate: Allocate = _plain_memory) -> None:
        """Keeps the memory of at most ``most`` arrays that nobody has any more."""
        self._shape = shape
        self._allocate = allocate
        self._free: deque[Image] = deque(maxlen=most)

    def take(self) -> Image:
        """An array of the shape, uint8, its content arbitrary."""
        try:
            memory = self._free.pop()
        except IndexError:
            memory = self._allocate(self._shape)
        lent: Image = np.asarray(_Lent(memory, self._free))
        return lent


class _Lent:
    """What a lent array and all its views hold on to: with the last of them, the memory is given back."""

    def __init__(self, memory: Image, free: deque[Image]) -> None:
        self.__array_interface__ = memory.__array_interface__
        self._memory = memory
        self._free = free

    def __del__(self) -> None:
        self._free.append(self._memory)
