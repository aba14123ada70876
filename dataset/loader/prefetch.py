"""Prefetching: threads decode batches ahead."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dataset.errors import UnusablePictureError
from dataset.picture_spec import PictureSpec
from dataset.preprocessing import Image

_JOBS: Final = 4  # for each thread of a part: small enough that none waits long for the others' last one

Numbers = NDArray[np.int64]
Failed = dict[int, UnusablePictureError]
Fill = Callable[[Image, Numbers], Failed]
"""Writes the pictures of some numbers into an array; returns the numbers without one, and the reasons."""


def prefetched(
    parts: Iterable[Numbers], fill: Fill, spec: PictureSpec, *, threads: int, at_once: int
) -> Iterator[tuple[Numbers, Image, Failed]]:
    """Each part, what `fill` writes for it (N, `spec.shape`), and its numbers that have no picture, and why.

    `at_once` parts are worked on. What `fill` raises is raised in its part's turn.
    """
    waiting: deque[tuple[Numbers, Image, list[Future[Failed]]]] = deque()
    pool = ThreadPoolExecutor(threads)
    try:
        for part in parts:
            pictures = np.empty((len(part), *spec.shape), np.uint8)
            size = max(1, -(-len(part) // (_JOBS * threads)))
            starts = range(0, len(part), size)
            jobs = [pool.submit(fill, pictures[i : i + size], part[i : i + size]) for i in starts]
            waiting.append((part, pictures, jobs))
            if len(waiting) == at_once:
                yield _finished(*waiting.popleft())
        while waiting:
            yield _finished(*waiting.popleft())
    finally:
        pool.shutdown(cancel_futures=True)


def _finished(part: Numbers, pictures: Image, jobs: list[Future[Failed]]) -> tuple[Numbers, Image, Failed]:
    return part, pictures, {number: error for job in jobs for number, error in job.result().items()}
