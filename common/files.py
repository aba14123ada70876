"""Write files atomically: complete or not at all, and without replacing an existing file by mistake."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from common.errors import UserError
from common.interrupts import uninterrupted
from common.location import Location
from common.untrusted import real_path

PART_SUFFIX = ".part"

_REMEDIES: Final = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), "make room"),
    **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), "choose a folder that you may write to"),
}


def write_remedy(error: OSError) -> str:
    """The next step for a user whose file could not be written."""
    return _REMEDIES.get(error.errno or 0, "check the folder")


def part_path(path: Path) -> Path:
    """A new temporary name in the folder of `path`. It is not hidden, so that the user finds it after a crash."""
    return path.with_name(f"{path.name}.{os.urandom(3).hex()}{PART_SUFFIX}")


def final_path(path: Path) -> Path:
    """The final path of a file with a temporary name (`part_path`); any other path unchanged."""
    return path.with_name(final_name(path.name))


def final_name(name: str) -> str:
    """The final name of a file with a temporary name, without a folder; any other name unchanged."""
    return re.sub(rf"(?<=.)\.[0-9a-f]{{6}}{re.escape(PART_SUFFIX)}$", "", name)


def session_name(log: Location) -> str:
    """NAME of NAME.mcap, and of NAME.mcap.XXXXXX.part (an unfinished recording)."""
    return final_name(log.name).removesuffix(".mcap")


def make_folder(folder: Path) -> list[Path]:
    """Create a folder and its parents. Returns the created folders, innermost first, for `remove_empty`."""
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    return missing


def remove_empty(folders: Sequence[Path]) -> None:
    for folder in folders:
        with contextlib.suppress(OSError):
            folder.rmdir()


def refuse_existing(path: Path, overwrite: bool, instead: str = "choose another name") -> None:
    """Raise UserError if `path` is a folder, or if it exists (also as a dangling link) and `overwrite` is false.
    `instead` is the advice in the error."""
    if path.is_dir():
        raise UserError(f"{path} is a folder: give a file name")
    if not overwrite and (path.exists() or path.is_symlink()):
        raise UserError(f"{path} exists already: {instead}, or give --force to replace it")


def publish(part: Path, path: Path, overwrite: bool) -> None:
    """Rename the finished file `part` to `path`, atomically. Call this in an `uninterrupted` block.

    Without `overwrite`, an existing file is never replaced. If `path` exists by now, or the system refuses the
    rename, raises UserError and keeps `part`.
    """
    try:
        if overwrite:
            part.replace(path)
        else:
            _name_unless_taken(part, path)
    except OSError as error:
        raise UserError(f"{part} cannot be renamed to {path} ({error.strerror})") from None
    _sync_folder(path.parent)


def _name_unless_taken(part: Path, path: Path) -> None:
    try:
        os.link(part, path)  # unlike rename, link fails if the name exists, also if another process just wrote it
    except FileExistsError:
        raise _taken(path, part) from None
    except OSError:  # a file system without hard links (FAT, some network shares)
        if path.exists() or path.is_symlink():
            raise _taken(path, part) from None
        part.rename(path)
    else:
        part.unlink()


def _taken(path: Path, part: Path) -> UserError:
    return UserError(
        f"{path} was written by another process at the same time: rename {part}, the new file, to keep it"
    )


def _sync_folder(folder: Path) -> None:
    """Write a new name to the disk: without this, a power cut may undo the rename."""
    if os.name != "posix":
        return
    with contextlib.suppress(OSError):  # some network file systems cannot
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


class BackgroundSync:
    """Flushes a file to the disk on a separate thread, because this may take a second."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = os.dup(descriptor)
        self._wanted = threading.Event()
        self._is_closing = False
        self._error: OSError | None = None
        self._thread = threading.Thread(target=self._run, name="sync", daemon=True)
        self._thread.start()

    def request(self) -> None:
        """Request a flush of everything written so far. Raises OSError if an earlier flush failed."""
        if self._error is not None:
            raise self._error
        self._wanted.set()

    def close(self) -> None:
        """Raises OSError if a flush failed: the system reports a lost write only once, to that flush."""
        self._is_closing = True
        self._wanted.set()
        self._thread.join()
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        try:
            while True:
                self._wanted.wait()
                self._wanted.clear()
                if self._is_closing:
                    return
                os.fsync(self._descriptor)
        except OSError as error:
            self._error = error
        finally:
            os.close(self._descriptor)


@contextlib.contextmanager
def atomic_file(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary path to write to. At the end it is renamed to `path`; if the block raises, it is removed.

    Raises UserError if `path` exists and `overwrite` is false.
    """
    refuse_existing(path, overwrite)
    part = part_path(path)
    folders = make_folder(path.parent)
    is_made = False
    try:
        yield part
        with uninterrupted():
            with part.open("rb+") as stream:
                os.fsync(stream.fileno())
            is_made = True  # keep `part` if the rename fails: the error names it
            publish(part, path, overwrite)
    except BaseException:
        with uninterrupted():
            if not is_made:
                part.unlink(missing_ok=True)
                remove_empty(folders)
        raise


@contextlib.contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder to fill. At the end it is renamed to `folder`; if the block raises, it is removed.

    Raises UserError if `folder` exists: its content is never replaced.
    """
    if folder.exists() or folder.is_symlink():
        raise UserError(f"{folder} exists already: choose another name, or remove it")
    part = part_path(folder)
    above = make_folder(folder.parent)
    try:
        part.mkdir()
        yield part
        with uninterrupted():
            for path in part.rglob("*"):
                _sync(path)
            _name_folder(part, folder)
            _sync_folder(folder.parent)
    except BaseException:
        with uninterrupted():
            shutil.rmtree(part, ignore_errors=True)
            remove_empty(above)
        raise


def _sync(path: Path) -> None:
    if path.is_dir():
        _sync_folder(path)
    else:
        with path.open("rb+") as stream:
            os.fsync(stream.fileno())


def _name_folder(part: Path, folder: Path) -> None:
    try:
        part.rename(folder)  # fails if another process has made and filled a folder of this name
    except OSError as error:
        raise UserError(f"{folder} cannot be created ({error.strerror}); nothing was kept") from None


def short_path(path: Path) -> Path:
    """The path relative to the working folder, if the folder contains it; else the absolute path."""
    resolved = real_path(path)
    return resolved.relative_to(Path.cwd()) if resolved.is_relative_to(Path.cwd()) else resolved
