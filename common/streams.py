"""Standard output and error that never delay a command: a separate thread writes the lines.

A pipe that nobody reads accepts 64 KiB, and a terminal stopped by Ctrl-S less. After that a write waits, and a
simulator would wait for its answer. If the reader has gone (`| head -1`, a closed terminal), only the unread lines
are lost: the command finishes its work, and ends with its own exit code.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import re
import sys
import threading
import time
from collections.abc import Iterator
from queue import SimpleQueue
from typing import Any, Final, NoReturn, TextIO

from common.errors import counted
from common.interrupts import leave_signals_to_main_thread

MAX_QUEUED: Final = 10_000
"""Texts that wait for their reader. If the queue is full, messages are dropped and counted; results wait."""
_POLL_S: Final = 0.01
_PATIENCE_S: Final = 2.0  # at the end, for a reader that reads nothing
_GONE: Final = {errno.EPIPE, errno.EIO, errno.ECONNRESET, errno.EBADF, errno.ENXIO}
_COLOUR_OR_OTHER: Final = re.compile(r"\x1b\[[0-9;]*m|[^\n\t]")


class BackgroundWriter:
    """Writes to a terminal, a pipe or a file on a separate thread."""

    def __init__(self, raw: Any) -> None:
        """`raw`: an unbuffered binary file."""
        self._raw = raw
        self._waiting: SimpleQueue[bytes | threading.Event] = SimpleQueue()  # `put` may be interrupted by a `put`
        self._lost = 0
        self._taken_bytes = 0
        self._carries_results = False
        self.error: OSError | None = None
        threading.Thread(target=self._run, name="output", daemon=True).start()

    def put(self, data: bytes, *, is_result: bool) -> None:
        """Queue `data`. Returns at once for a message; for a result, waits while the queue is full."""
        self._carries_results |= is_result
        while self._waiting.qsize() >= MAX_QUEUED and self.error is None:
            if not is_result:
                self._lost += 1
                return
            time.sleep(_POLL_S)
        self._waiting.put(data)

    def drain(self, *, is_patient: bool) -> None:
        """Wait until everything is written, or the reader has gone.

        If the reader has stopped reading, as `less` does until somebody scrolls: wait without limit if
        `is_patient` and results were written, else `_PATIENCE_S`.
        """
        done = threading.Event()
        self._waiting.put(done)
        taken_bytes, since_s = self._taken_bytes, time.monotonic()
        while not done.wait(0.1):
            if self._taken_bytes != taken_bytes:
                taken_bytes, since_s = self._taken_bytes, time.monotonic()
            elif not (is_patient and self._carries_results) and time.monotonic() - since_s >= _PATIENCE_S:
                return

    def _run(self) -> None:
        leave_signals_to_main_thread()
        while True:
            item = self._waiting.get()
            if isinstance(item, threading.Event):
                item.set()
                continue
            self._write(item)
            if self._lost and self._waiting.empty():
                lost, self._lost = self._lost, 0
                self._write(f"({counted(lost, 'message')} lost here: nobody read them)\n".encode())

    def _write(self, data: bytes) -> None:
        left = memoryview(data)
        while left and self.error is None:
            try:
                taken_bytes = self._raw.write(left)
            except OSError as error:
                self.error = error
                return
            if taken_bytes is None:  # full, and non-blocking because the parent process has set it so
                time.sleep(_POLL_S)
                continue
            self._taken_bytes += taken_bytes
            left = left[taken_bytes:]


class BackgroundStream(io.TextIOBase):
    """A text stream to a `BackgroundWriter`. It escapes control characters except colours; `unescaped` is the same
    stream without escaping, for callers that escape by themselves."""

    def __init__(self, writer: BackgroundWriter, stream: TextIO, *, is_result: bool, escapes: bool = True) -> None:
        """`stream` is the stream that this one replaces."""
        self.writer = writer
        self._stream = stream
        self._is_result = is_result
        self._escapes = escapes
        self.unescaped = self
        if escapes:
            self.unescaped = BackgroundStream(writer, stream, is_result=is_result, escapes=False)

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._stream.encoding

    @property
    def errors(self) -> str:  # type: ignore[override]
        return "backslashreplace"  # file names may have characters that the encoding lacks

    def write(self, text: str) -> int:
        safe = text if not self._escapes or text.isprintable() else _COLOUR_OR_OTHER.sub(_escaped, text)
        if os.linesep != "\n":
            safe = safe.replace("\n", os.linesep)
        self.writer.put(safe.encode(self.encoding, self.errors), is_result=self._is_result)
        return len(text)

    def flush(self) -> None:
        """Do nothing: the stream keeps no text back, and never waits for its reader."""

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return self._stream.isatty()

    def fileno(self) -> int:
        return self._stream.fileno()


@contextlib.contextmanager
def nonblocking_streams() -> Iterator[None]:
    """Replace `sys.stdout` and `sys.stderr` in the block by streams that never wait. Call `drain` before the end.

    Streams without a file descriptor (a test has replaced them) stay unchanged.
    """
    before = sys.stdout, sys.stderr
    if any(stream is not None and not _is_of_system(stream) for stream in before):
        yield
        return
    out, err = (stream or open(os.devnull, "w", encoding="utf-8") for stream in before)  # noqa: SIM115, PTH123
    writer = BackgroundWriter(_raw(out))
    # both on one terminal: one writer keeps the order of the lines
    other = writer if os.path.sameopenfile(out.fileno(), err.fileno()) else BackgroundWriter(_raw(err))
    sys.stdout = BackgroundStream(writer, out, is_result=True)
    sys.stderr = BackgroundStream(other, err, is_result=False)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def drain(*, is_patient: bool = True) -> None:
    """Wait until all lines of stdout and stderr are written. See `BackgroundWriter.drain`."""
    for stream in (sys.stdout, sys.stderr):
        beneath = unescaped(stream)
        if isinstance(beneath, BackgroundStream):
            beneath.writer.drain(is_patient=is_patient)
        elif beneath is not None:  # closed from the start
            beneath.flush()


def stdout_error() -> str | None:
    """The reason why results could not be written, such as a full disk. None if all were written, or if the reader
    has gone."""
    beneath = unescaped(sys.stdout)
    error = beneath.writer.error if isinstance(beneath, BackgroundStream) else None
    return None if error is None or error.errno in _GONE else error.strerror


def end_process(code: int) -> NoReturn:
    """Write the lines that the reader still accepts, then end at once, as `os._exit` does."""
    try:
        drain(is_patient=False)
    finally:
        os._exit(code)


def unescaped(stream: TextIO) -> TextIO:
    """The stream beneath `stream` that does not escape, also if a progress bar has replaced it."""
    beneath = getattr(stream, "rich_proxied_file", stream)
    return getattr(beneath, "unescaped", beneath)


def _is_of_system(stream: TextIO) -> bool:
    try:
        stream.fileno()
    except (OSError, ValueError):
        return False
    return hasattr(stream, "buffer")


def _raw(stream: Any) -> Any:
    """The unbuffered file of a stream; under `python -u`, the buffer itself is unbuffered."""
    stream.flush()
    return getattr(stream.buffer, "raw", stream.buffer)


def _escaped(match: re.Match[str]) -> str:
    text = match[0]
    return text if len(text) > 1 or text.isprintable() else ascii(text)[1:-1]
