"""Files that appear whole or not at all, and are never overwritten unasked."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

from common.errors import UserError

PART_SUFFIX = ".part"


def part_path(path: Path) -> Path:
    """A fresh temporary name beside `path`: visible, so that after a crash its owner finds it."""
    return path.with_name(f"{path.name}.{secrets.token_hex(3)}{PART_SUFFIX}")


def refuse_existing(path: Path, overwrite: bool) -> None:
    """Raise UserError if `path` exists (a dangling link counts) and may not be overwritten."""
    if path.is_dir():
        raise UserError(f"{path} is a folder, a file name was expected: give another name")
    if not overwrite and (path.exists() or path.is_symlink()):
        raise UserError(f"{path} exists already: choose another name, or give --force to replace it")


def publish(part: Path, path: Path, overwrite: bool) -> None:
    """Give the finished file `part` its name `path`, in one step.

    Without `overwrite`, a file that has appeared under that name meanwhile wins, and UserError is raised;
    `part` is then still there.
    """
    if overwrite:
        part.replace(path)
        return
    try:
        os.link(part, path)  # unlike rename, link fails if the name is taken: no window for a second writer
    except FileExistsError:
        raise UserError(f"{path} was written by someone else meanwhile: what was made here is {part}") from None
    except OSError:  # a file system without hard links (FAT, some network shares)
        refuse_existing(path, overwrite)
        part.rename(path)
    else:
        part.unlink()


@contextlib.contextmanager
def whole_file(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary path to write to; it becomes `path` at the end, or vanishes if anything is raised."""
    refuse_existing(path, overwrite)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = part_path(path)
    try:
        yield part
        with part.open("rb+") as stream:
            os.fsync(stream.fileno())
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    publish(part, path, overwrite)
