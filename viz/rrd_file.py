"""Write a Rerun recording to a file, which appears whole or not at all."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final

import rerun as rr
import rerun.blueprint as rrb

from common import UserError, atomic_file
from common.files import write_remedy

APPLICATION: Final = "behavioural-cloning-toolkit"

_READ_BYTES: Final = 1 << 20


@dataclass(frozen=True)
class RrdFile:
    recording: rr.RecordingStream
    has_failed: threading.Event  # set when the file can no longer be written


@contextlib.contextmanager
def rrd_file(
    path: Path, *, overwrite: bool, recording_id: str | None = None, layout: rrb.Blueprint | None = None
) -> Iterator[RrdFile]:
    """Yield a recording that is written to the file `path`.

    Raises UserError if `path` exists and may not be overwritten, or if the disk is full; then no new file remains.
    """
    with atomic_file(path, overwrite=overwrite) as part:
        recording = rr.RecordingStream(APPLICATION, recording_id=recording_id)
        if sys.platform == "win32":  # pipes on Windows have no name that Rerun can open
            part.touch()  # raises if the folder cannot be written to; Rerun itself would hang
            recording.save(part, default_blueprint=layout)
            yield RrdFile(recording, threading.Event())
            recording.flush()
            recording.disconnect()
            return
        with part.open("xb", buffering=0) as stream:
            pipe = _Pipe(stream)
            try:
                recording.save(f"/dev/fd/{pipe.own_end}", default_blueprint=layout)
                pipe.close_own_end()
                yield RrdFile(recording, pipe.has_failed)
                recording.flush()
            finally:
                recording.disconnect()
                pipe.finish()
        if pipe.error is not None:
            why = pipe.error.strerror
            raise UserError(
                f"{path}: cannot be written ({why}); nothing of it was kept:"
                f" {write_remedy(pipe.error)}, and try again"
            )


class _Pipe(threading.Thread):
    """Receives Rerun's data and writes it to a file.

    On a full disk, Rerun itself may hang, or omit the end of a file without an error.
    """

    def __init__(self, stream: IO[bytes]) -> None:
        super().__init__(name="rrd", daemon=True)
        self.has_failed = threading.Event()
        self.error: OSError | None = None
        self._stream = stream
        self._from, self.own_end = os.pipe()
        self._is_own_end_open = True
        self.start()

    def run(self) -> None:
        while data := os.read(self._from, _READ_BYTES):
            if self.error is None:
                self._write(data)

    def close_own_end(self) -> None:
        """Close this end after Rerun has opened its own: the data then ends when Rerun closes its end."""
        if self._is_own_end_open:
            self._is_own_end_open = False
            os.close(self.own_end)

    def finish(self) -> None:
        self.close_own_end()
        self.join()
        os.close(self._from)

    def _write(self, data: bytes) -> None:
        """Write data to the file. After an error, `run` still receives Rerun's data, and drops it."""
        left = memoryview(data)
        try:
            while left:
                left = left[self._stream.write(left) :]
        except OSError as error:
            self.error = error
            self.has_failed.set()
