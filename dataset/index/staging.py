"""Change an index: new files are first written to a folder in the index, and then moved to their places.

    index/new.XXXXXX.part/samples.parquet, state.json, frames/SESSION.parquet   new files

samples.parquet has all that training reads: after a crash, it is the one of before, or the new one. The next build
makes the frames files again that do not fit.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from common.files import part_path
from common.interrupts import uninterrupted
from common.locks import lock
from dataset.errors import DatasetError, index_write_errors
from dataset.index.build_state import FRAMES_FOLDER, STATE_NAME
from dataset.parquet_file import read_metadata
from dataset.samples.samples_format import SAMPLES_NAME

_STAGE: Final = "new"


@contextlib.contextmanager
def staged(index: Path) -> Iterator[Path]:
    """Yield a folder for new files of `index`. At the end they are moved to their places; if the block raises,
    they are removed.

    If the folder has no samples.parquet, the index does not change. Lock the index before.
    """
    for left in index.glob(f"{_STAGE}.*.part"):  # of a killed build
        shutil.rmtree(left, ignore_errors=True)
    stage = part_path(index / _STAGE)
    try:
        with index_write_errors(stage):
            (stage / FRAMES_FOLDER).mkdir(parents=True)
        yield stage
        with uninterrupted():
            if (stage / SAMPLES_NAME).exists():
                _publish_all(stage, index)
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def stale_frames_files(sessions: set[str], index: Path) -> list[Path]:
    """The frames files of the toolkit that belong to none of these sessions."""
    return [
        file
        for file in sorted((index / FRAMES_FOLDER).glob("*.parquet"))
        if file.stem not in sessions
        and (read_metadata(file) or {}).keys() >= {"format", "fingerprint", "looked", "settings"}
    ]


def _publish_all(stage: Path, index: Path) -> None:
    sessions = set((read_metadata(stage / SAMPLES_NAME) or {}).get("logs", {}))
    names = [f"{FRAMES_FOLDER}/{file.name}" for file in sorted((stage / FRAMES_FOLDER).iterdir())]
    try:
        (index / FRAMES_FOLDER).mkdir(exist_ok=True)
        for file in stale_frames_files(sessions, index):
            file.unlink()
        for name in (*names, SAMPLES_NAME, STATE_NAME):
            (stage / name).replace(index / name)
    except OSError as error:
        raise DatasetError(f"{index}: cannot be changed ({error.strerror}); close programs that read it") from None


@contextlib.contextmanager
def build_lock(index: Path) -> Iterator[None]:
    """Lock the index during a build. A new folder is removed if the build fails and leaves nothing in it."""
    is_new, path = not index.exists(), index / ".lock"
    index.mkdir(parents=True, exist_ok=True)
    try:
        with path.open("ab") as stream:
            lock(stream)
            yield
    finally:
        if is_new and not (index / SAMPLES_NAME).exists():
            with contextlib.suppress(OSError):
                path.unlink()
                index.rmdir()
