"""Change an index atomically: new files are first written to a folder in the index, and then moved to their
places.

Several files cannot be renamed in one step. So the frames files to replace or remove are moved out first. Then the
new samples.parquet is moved in, then the new frames files. At every moment, the files in `frames` are of sessions
in samples.parquet, and of the same logs.

    index/new.XXXXXX.part/samples.parquet, state.json, frames/SESSION.parquet   new files
    index/new.XXXXXX.part/old/SESSION.parquet                                   files that were moved out

The folder `old` shows that all new files are complete. After a crash, the next build completes the change if `old`
exists; otherwise it removes the new files.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from common.files import final_path, part_path, publish
from common.interrupts import uninterrupted
from common.locks import lock
from dataset.errors import DatasetError, index_write_errors
from dataset.index.build_state import FRAMES_FOLDER, STATE_NAME
from dataset.parquet_file import read_metadata
from dataset.samples.samples_format import SAMPLES_NAME

_STAGE: Final = "new"
_OLD: Final = "old"


@contextlib.contextmanager
def staged(index: Path) -> Iterator[Path]:
    """Yield a folder for new files of `index`. At the end they are moved to their places; if the block raises,
    they are removed.

    If the folder has no samples.parquet, the index does not change. Lock the index before.
    """
    stage = part_path(index / _STAGE)
    try:
        with index_write_errors(stage):
            (stage / FRAMES_FOLDER).mkdir(parents=True)
        yield stage
        with uninterrupted():
            if (stage / SAMPLES_NAME).exists():
                _publish_all(stage, index)
    finally:
        with uninterrupted():
            if not (stage / _OLD).exists():
                shutil.rmtree(stage, ignore_errors=True)


def finish_interrupted_build(index: Path) -> None:
    """Complete the change of a killed build if its new files are complete, else remove them. Lock the index
    before."""
    for path in sorted(index.iterdir()):
        name = final_path(path).name
        if name == _STAGE and path.name != name:
            with uninterrupted():
                if (path / _OLD).exists():
                    _publish_all(path, index)
                shutil.rmtree(path, ignore_errors=True)


def stale_frames_files(sessions: set[str], index: Path) -> list[Path]:
    """The frames files of the toolkit that belong to none of these sessions."""
    return [
        file
        for file in sorted((index / FRAMES_FOLDER).glob("*.parquet"))
        if file.stem not in sessions
        and (read_metadata(file) or {}).keys() >= {"format", "fingerprint", "looked", "settings"}
    ]


def _publish_all(stage: Path, index: Path) -> None:
    """Move the new files to their places. If this was interrupted, the next call continues."""
    frames, old = index / FRAMES_FOLDER, stage / _OLD
    samples = stage / SAMPLES_NAME
    try:
        old.mkdir(exist_ok=True)
        if samples.exists():
            sessions = set((read_metadata(samples) or {}).get("logs", {}))
            stale = stale_frames_files(sessions, index)
            replaced = [frames / file.name for file in (stage / FRAMES_FOLDER).iterdir()]
            for file in [*stale, *filter(Path.exists, replaced)]:
                file.replace(old / file.name)
            samples.replace(index / SAMPLES_NAME)
    except BaseException as error:
        with contextlib.suppress(OSError):  # if this also fails, the next build completes the change
            for file in old.iterdir():
                file.replace(frames / file.name)
            old.rmdir()
        if isinstance(error, OSError):
            raise DatasetError(
                f"{index}: cannot be changed ({error.strerror}); close programs that read it"
            ) from None
        raise
    frames.mkdir(exist_ok=True)
    for file in sorted((stage / FRAMES_FOLDER).iterdir()):
        file.replace(frames / file.name)
    if (stage / STATE_NAME).exists():
        publish(stage / STATE_NAME, index / STATE_NAME, overwrite=True)
    shutil.rmtree(stage, ignore_errors=True)


@contextlib.contextmanager
def build_lock(index: Path) -> Iterator[None]:
    index.mkdir(parents=True, exist_ok=True)
    with (index / ".lock").open("ab") as stream:
        lock(stream)
        yield
