"""The thread that writes a drive's log, so that the driving loop never waits for the disk."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Final

from common import UserError

MAX_PICTURE_BYTES: Final = 128 << 20
"""The most bytes of pictures that wait: 35 s of driving at 60 frames a second, each with a JPEG of 15 KB and a
crop of 48 KB."""
MAX_WAITING: Final = 36_000
"""The most rows and events that wait: ten minutes of driving at 60 frames a second, 100 MB without pictures."""

_IDLE_S: Final = 0.1


class LogThread:
    """Calls the functions that it is given, in their order, on a thread of its own; and `flush` while it is idle.

    It is as important to the system as the driving loop: one that sleeps while it holds Python's lock would stop
    the loop with it.

    Not to be called by two threads at once.
    """

    def __init__(self, flush: Callable[[], None]) -> None:
        self.failure: UserError | None = None
        self._bug: Exception | None = None
        self._flush = flush
        self._queue: SimpleQueue[tuple[Callable[[], None], int] | None] = SimpleQueue()
        # each of these is written by one thread only: none needs a lock
        self._put_count = self._put_bytes = 0
        self._done_count = self._done_bytes = 0
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()

    @property
    def has_room(self) -> bool:
        """True if another row or event may wait."""
        return self._put_count - self._done_count < MAX_WAITING

    def has_room_for(self, picture_bytes: int) -> bool:
        """True if pictures of so many bytes may wait."""
        return self._put_bytes - self._done_bytes + picture_bytes <= MAX_PICTURE_BYTES

    def put(self, write: Callable[[], None], picture_bytes: int = 0) -> None:
        """Have `write` called soon; after a failure nothing is called any more. Raises errors that no disk
        causes."""
        if self._bug is not None:
            raise self._bug
        if self.failure is None:
            self._put_count += 1
            self._put_bytes += picture_bytes
            self._queue.put((write, picture_bytes))

    def close(self) -> None:
        """Wait until everything is written. Raises errors that no disk causes."""
        self._queue.put(None)
        self._thread.join()
        if self._bug is not None:
            raise self._bug

    def _run(self) -> None:
        while True:
            try:
                item = self._queue.get(timeout=_IDLE_S)
            except Empty:
                self._call(self._flush)
                continue
            if item is None:
                return
            write, picture_bytes = item
            self._call(write)
            self._done_bytes += picture_bytes
            self._done_count += 1

    def _call(self, write: Callable[[], None]) -> None:
        if self.failure is not None or self._bug is not None:
            return
        try:
            write()
        except UserError as error:
            self.failure = error
        except Exception as error:
            self._bug = error
