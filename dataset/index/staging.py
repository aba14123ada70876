"""An index changes whole or not at all: new files are written to a folder in it, and then all get their names.

Several files cannot be renamed in one step. So the frames files that are replaced, or whose sessions the new index
does not hold, are moved out first; then the new samples.parquet comes, then the new frames. At every moment the
files in `frames` are of sessions that samples.parquet holds, and were made from the same logs.

    index/new.XXXXXX.part/samples.parquet, state.json, frames/SESSION.parquet   what is new
    index/new.XXXXXX.part/old/SESSION.parquet                                   what was moved out

`old` shows that everything new was on the disk: a killed build is then carried through, and else removed.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Final

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
    """Yield a folder for new files of `index`: these get their names in the end, or vanish if anything is raised.

    Without a new samples.parquet in it nothing changes. Call it with the index locked.
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
    """Carry through what a killed build had decided on, and remove the rest. Call it with the index locked."""
    for path in sorted(index.iterdir()):
        name = final_path(path).name
        if name == _STAGE and path.name != name and path.is_dir() and not path.is_symlink():
            folders = (path / _OLD, path / FRAMES_FOLDER)
            with uninterrupted():
                if all(folder.is_dir() and not folder.is_symlink() for folder in folders):
                    _publish_all(path, index)
                shutil.rmtree(path, ignore_errors=True)


def stale_frames_files(sessions: set[str], index: Path) -> list[Path]:
    """The frames files that were made by us, and are of none of these sessions; also the parts that older versions
    left there when they were killed."""
    try:
        files = sorted((index / FRAMES_FOLDER).iterdir())
    except OSError:
        return []
    return [file for file in files if file.name.removesuffix(".parquet") not in sessions and _is_ours(file)]


def _publish_all(stage: Path, index: Path) -> None:
    """Give the new files their names; as often as it was stopped half-way, it goes on where it was."""
    frames, old = index / FRAMES_FOLDER, stage / _OLD
    samples = stage / SAMPLES_NAME
    try:
        old.mkdir(exist_ok=True)
        if samples.exists():
            sessions = set((read_metadata(samples) or {}).get("logs", {}))
            gone = stale_frames_files(sessions, index)
            replaced = [frames / file.name for file in (stage / FRAMES_FOLDER).iterdir()]
            for file in [*gone, *filter(Path.exists, replaced)]:
                file.replace(old / file.name)
            samples.replace(index / SAMPLES_NAME)
    except BaseException as error:
        with contextlib.suppress(OSError):  # if that fails too, the next build carries it through
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


def _is_ours(file: Path) -> bool:
    if file.is_symlink() or not file.is_file():
        return False
    if (final := final_path(file)) != file and final.suffix == ".parquet":
        return True
    return (read_metadata(file) or {}).keys() >= {"format", "fingerprint", "looked", "settings"}


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
    path = index / ".lock"
    while True:
        index.mkdir(parents=True, exist_ok=True)
        with contextlib.ExitStack() as stack, contextlib.suppress(FileNotFoundError):
            stream = stack.enter_context(path.open("ab"))
            lock(stream)
            if os.path.samestat(path.stat(), os.fstat(stream.fileno())):
                stack.pop_all()
                return stream
