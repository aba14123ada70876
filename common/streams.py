"""Standard output and error of a command. If the reader has gone (`| head -1`, a closed terminal), only the unread
lines are lost: the command finishes its work, and ends with its own exit code.

A drive never waits for its reader (`never_wait`): a pipe that nobody reads accepts 64 KiB, and a terminal stopped
by Ctrl-S less. After that a write waits, and a simulator would wait for its answer.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys
import threading
import time
from collections.abc import Iterator
from queue import Full, Queue
from typing import Final, TextIO

MAX_QUEUED: Final = 10_000
"""Texts of a drive that wait for their reader; more are dropped."""
_PATIENCE_S: Final = 2.0  # at the end of a drive, for a reader that reads nothing
_POLL_S: Final = 0.01
_GONE: Final = {errno.EPIPE, errno.EIO, errno.ECONNRESET, errno.EBADF, errno.ENXIO}

_waiting: Queue[tuple[CommandStream, bytes]] | None = None


class CommandStream(io.TextIOBase):
    """A text stream that is written at once, without a buffer or a lock, and that may lose its reader."""

    def __init__(self, stream: TextIO, name: str) -> None:
        """`stream` is the stream that this one replaces; errors have the `name`, unless it is empty."""
        stream.flush()
        self._stream = stream
        self._descriptor = stream.fileno()
        self._name = name
        self._is_lost = False

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._stream.encoding

    @property
    def errors(self) -> str:  # type: ignore[override]
        return "backslashreplace"  # file names may have characters that the encoding lacks

    def write(self, text: str) -> int:
        data = text.replace("\n", os.linesep).encode(self.encoding, self.errors)
        if _waiting is None:
            self.write_now(data)
        else:
            with contextlib.suppress(Full):
                _waiting.put_nowait((self, data))
        return len(text)

    def write_now(self, data: bytes) -> None:
        while data and not self._is_lost:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:  # full, and non-blocking because the parent process has set it so
                time.sleep(_POLL_S)
            except OSError as error:
                self._is_lost = True
                if self._name and error.errno not in _GONE:  # such as a full disk
                    raise OSError(error.errno, error.strerror, self._name) from None

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return self._stream.isatty()

    def fileno(self) -> int:
        return self._descriptor


@contextlib.contextmanager
def command_streams() -> Iterator[None]:
    """Replace `sys.stdout` and `sys.stderr` in the block, unless they have no file descriptor, as in tests."""
    before = sys.stdout, sys.stderr
    if any(stream is not None and not _is_of_system(stream) for stream in before):
        yield
        return
    # None: closed from the start
    out, err = (stream or open(os.devnull, "w", encoding="utf-8") for stream in before)  # noqa: SIM115, PTH123
    sys.stdout, sys.stderr = CommandStream(out, "standard output"), CommandStream(err, "")
    try:
        yield
    finally:
        _finish()
        sys.stdout, sys.stderr = before


def never_wait() -> None:
    """From now on, a thread writes what this command prints."""
    global _waiting
    if isinstance(sys.stdout, CommandStream) and _waiting is None:
        _waiting = Queue(MAX_QUEUED)
        threading.Thread(target=_write_waiting, args=(_waiting,), name="output", daemon=True).start()


def _write_waiting(waiting: Queue[tuple[CommandStream, bytes]]) -> None:
    while True:
        stream, data = waiting.get()
        with contextlib.suppress(OSError):
            stream.write_now(data)
        waiting.task_done()


def _finish() -> None:
    """Wait until all is written, or until the reader has read nothing for `_PATIENCE_S`."""
    global _waiting
    left, since_s = 0, time.monotonic()
    while _waiting is not None and _waiting.unfinished_tasks and time.monotonic() - since_s < _PATIENCE_S:
        if _waiting.unfinished_tasks != left:
            left, since_s = _waiting.unfinished_tasks, time.monotonic()
        time.sleep(_POLL_S)
    _waiting = None


def _is_of_system(stream: TextIO) -> bool:
    try:
        stream.fileno()
    except (OSError, ValueError):
        return False
    return hasattr(stream, "buffer")
