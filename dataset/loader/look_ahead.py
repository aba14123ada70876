"""Look-ahead in an epoch's order: chunks of logs in stores are fetched before the next batches need them.

The order is a function of (seed, epoch), so it is known; nothing of it changes. Chunks that lie side by side come
in one request, and as many requests are on their way as a store answers at a time.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from common.closeable import Closeable
from dataset.samples.sample_rows import Rows
from recorder import Log

_AT_ONCE: Final = 16  # requests: at 50 ms each and 4 MB, more than 1 GB/s
_MAX_BYTES: Final = 1 << 28  # on their way
_MAX_SAMPLES: Final = 1 << 15  # ahead of the batch that is wanted now

_LOG: Final = logging.getLogger(__name__)

Numbers = NDArray[np.int64]


class LookAhead(Closeable):
    """Fetches the chunks of the pictures that some rows show."""

    def __init__(self, rows: Rows, logs: Mapping[str, Log]) -> None:
        self._logs = [logs[session] for session in rows.sessions]
        self._session = rows.session
        self._chunk = np.full(len(rows.session), -1, np.int64)  # of each picture: its number in its log
        for number, log in enumerate(self._logs):
            if log.fetched is not None:
                of_log = np.flatnonzero(rows.session == number)
                self._chunk[of_log] = log.chunk_numbers(rows.offset[of_log], rows.chunk[of_log])
        self._pool = ThreadPoolExecutor(_AT_ONCE, "look-ahead")
        self._lock = threading.Lock()
        self._coming_bytes = 0
        self._warn_if_too_small()

    @classmethod
    def of(cls, rows: Rows, logs: Mapping[str, Log]) -> LookAhead | None:
        """None where all logs are on this machine."""
        is_remote = any(logs[session].fetched is not None for session in rows.sessions)
        return cls(rows, logs) if is_remote else None

    def close(self) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)

    def parts(self, parts: Iterable[Numbers], wanted: Callable[[Numbers], Numbers]) -> Iterator[Numbers]:
        """The same parts, in their order. `wanted`: the pictures that have to be read for some samples."""
        requested: dict[int, NDArray[np.bool_]] = {}  # of each log, its chunks that were requested in this pass
        ahead, samples = deque[Numbers](), 0
        coming = iter(parts)
        is_over = False
        while True:
            new: list[Numbers] = []
            new_bytes = 0
            while not is_over and (not ahead or self._coming_bytes + new_bytes < _MAX_BYTES):
                if ahead and samples > _MAX_SAMPLES:
                    break
                part = next(coming, None)
                if part is None:
                    is_over = True
                    break
                ahead.append(part)
                samples += len(part)
                pictures, part_bytes = self._not_requested(wanted(part), requested)
                new.append(pictures)
                new_bytes += part_bytes
            self._fetch(new)
            if not ahead:
                return
            samples -= len(ahead[0])
            yield ahead.popleft()

    def _not_requested(self, pictures: Numbers, requested: dict[int, NDArray[np.bool_]]) -> tuple[Numbers, int]:
        """One picture of each chunk that was not requested yet, and the bytes of these chunks."""
        pictures = pictures[self._chunk[pictures] >= 0]
        chosen, size = [], 0
        for session in np.unique(self._session[pictures]).tolist():
            log = self._logs[session]
            assert log.fetched is not None  # noqa: S101
            is_requested = requested.setdefault(session, np.zeros(len(log.chunks), np.bool_))
            of_session = pictures[self._session[pictures] == session]
            chunks, first = np.unique(self._chunk[of_session], return_index=True)
            is_new = ~is_requested[chunks]
            is_requested[chunks[is_new]] = True
            chosen.append(of_session[first[is_new]])
            size += log.fetched.sizes(chunks[is_new].tolist())
        return np.concatenate([*chosen, np.zeros(0, np.int64)]), size

    def _fetch(self, pictures: list[Numbers]) -> None:
        every = np.concatenate([*pictures, np.zeros(0, np.int64)])
        for session in np.unique(self._session[every]).tolist():
            fetched = self._logs[session].fetched
            assert fetched is not None  # noqa: S101
            chunks = np.unique(self._chunk[every[self._session[every] == session]]).tolist()
            for run in fetched.runs(fetched.missing(chunks)):
                size = fetched.sizes(run)
                with self._lock:
                    self._coming_bytes += size
                self._pool.submit(fetched.fetch, run).add_done_callback(self._when_done(size))

    def _when_done(self, size: int) -> Callable[[Future[Any]], None]:
        def done(future: Future[Any]) -> None:
            with self._lock:
                self._coming_bytes -= size
            if not future.cancelled():
                future.exception()  # a batch that needs one of these chunks requests it again, and gets the error

        return done

    def _warn_if_too_small(self) -> None:
        """Log a warning if chunks will have gone from the disk before their next picture is read."""
        size, most = 0, 0
        for number, log in enumerate(self._logs):
            if log.fetched is not None:
                size += log.fetched.sizes(np.unique(self._chunk[self._session == number]).tolist())
                most = log.fetched.max_bytes
        if size > most:
            _LOG.warning(
                "the pictures take %.1f GB, but only %.1f GB of them are kept here: the same are fetched again and"
                " again; give BC_CACHE_GB=%.0f and the disk for it",
                size / 1e9,
                most / 1e9,
                1.1 * size / 1e9 + 1,
            )
