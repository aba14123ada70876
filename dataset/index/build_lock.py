"""One build of an index at a time."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Final

from common.locks import lock
from dataset.samples.samples_format import SAMPLES_NAME

LOCK_NAME: Final = ".lock"


@contextlib.contextmanager
def build_lock(index: Path) -> Iterator[None]:
    """Let one at a time build this index; where none comes of it, nothing stays of what this has made."""
    made = [folder for folder in (index, *index.parents) if not folder.exists()]
    with _locked(index) as stream:
        try:
            yield
        finally:
            if not (index / SAMPLES_NAME).exists():
                with contextlib.suppress(OSError):  # somebody else's files; Windows removes no open one
                    Path(stream.name).unlink()
                    for folder in made:
                        folder.rmdir()


def _locked(index: Path) -> IO[bytes]:
    """The lock's file, locked until it is closed."""
    path = index / LOCK_NAME
    while True:
        index.mkdir(parents=True, exist_ok=True)
        with contextlib.ExitStack() as stack, contextlib.suppress(FileNotFoundError):
            stream = stack.enter_context(path.open("ab"))
            lock(stream)
            if os.path.samestat(path.stat(), os.fstat(stream.fileno())):
                stack.pop_all()
                return stream
