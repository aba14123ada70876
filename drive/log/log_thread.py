"""A thread that writes a drive's log, so that the driving loop never waits for the disk."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Final

from common import UserError

MAX_PICTURE_BYTES: Final = 128 << 20
"""Maximum bytes of pictures in the queue: 35 s of driving at 60 frames a second, each with a JPEG of 15 KB and a
crop of 48 KB."""
MAX_WAITING: Final = 36_000
"""Maximum rows and events in the queue: ten minutes of driving at 60 frames a second, 100 MB without pictures."""

_IDLE_S: Final = 0.1


class LogThread:
    """Calls the functions given to `put`, in order, on its own thread, and `flush` while it is idle.

    The thread has the same priority as the driving loop: if it slept while it holds Python's lock, it would stop
    the loop.

    Two threads must not call it at once.
    """

    def __init__(self, flush: Callable[[], None]) -> None:
        self.failure: UserError | None = None
        self._bug: Exception | None = None
        self._flush = flush
        self._queue: SimpleQueue[tuple[Callable[[], None], int] | None] = SimpleQueue()
        # only one thread writes each of these, so they need no lock
        self._put_count = self._put_bytes = 0
        self._done_count = self._done_bytes = 0
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()

    @property
    def has_room(self) -> bool:
        """True if the queue has room for another row or event."""
        return self._put_count - self._done_count < MAX_WAITING

    def has_room_for(self, picture_bytes: int) -> bool:
        """True if the queue has room for `picture_bytes` of pictures."""
        return self._put_bytes - self._done_bytes + picture_bytes <= MAX_PICTURE_BYTES

    def put(self, write: Callable[[], None], picture_bytes: int = 0) -> None:
        """Queue a call of `write`. After a failure, nothing is called any more. Raises an unexpected error of an
        earlier call."""
        if self._bug is not None:
            raise self._bug
        if self.failure is None:
            self._put_count += 1
            self._put_bytes += picture_bytes
            self._queue.put((write, picture_bytes))

    def close(self) -> None:
        """Wait until everything is written. Raises an unexpected error of a call."""
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
