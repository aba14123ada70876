"""Copies of stores' logs on this machine's disk: fetched once, and then read as files.

They are in the user's cache. BC_CACHE names another folder. BC_CACHE_GB limits their total size (100). If the
cache is full, the least recently used logs are removed. A gigabyte of the disk always stays free.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Final

from common.errors import UsageError, UserError
from common.files import PART_SUFFIX, atomic_file
from common.locks import lock, try_lock
from common.output import print_message
from common.progress import progress_bar, progress_task
from common.users_cache import users_cache
from recorder.log.reader import Log

_DEFAULT_GB: Final = 100.0
_STAYS_FREE: Final = 10**9  # bytes of the disk


def bring_here(logs: Iterable[Log]) -> None:
    """Let open logs read from this machine's disk: logs in stores are fetched, unless their copies exist.

    Raises UserError if there is no room for all of them, or the cache cannot be written; StoreError.
    """
    remote = [log for log in logs if log.is_remote]
    try:
        if missing := [log for log in remote if not read_copy(log)]:
            folder = _folder()
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            with (folder / ".lock").open("ab") as stream:
                if not try_lock(stream):
                    print_message("waiting for another process that fetches logs")
                    lock(stream)
                missing = [log for log in missing if not read_copy(log)]
                _make_room(set(map(_copy_of, remote)), sum(log.size for log in missing))
                _fetch(missing)
    except OSError as error:
        raise UserError(
            f"{users_cache()}: logs cannot be fetched to it ({error.strerror}); BC_CACHE names another folder"
        ) from None


def read_copy(log: Log) -> bool:
    """Let an open log of a store read from its copy; False if there is none. Raises OSError."""
    path = _copy_of(log)
    with contextlib.suppress(FileNotFoundError):
        if path.stat().st_size == log.size:
            os.utime(path)
            log.read_from(path)
            return True
    return False


def _folder() -> Path:
    return users_cache() / "logs"


def _copy_of(log: Log) -> Path:
    digest = hashlib.sha256(f"{log.path} {log.file_fingerprint}".encode()).hexdigest()
    return _folder() / f"{digest[:32]}.mcap"


def _fetch(logs: Sequence[Log]) -> None:
    size = sum(log.size for log in logs)
    with progress_bar() as bar, progress_task(bar, "fetching logs, bytes", size) as advance:
        for log in logs:
            with atomic_file(_copy_of(log), overwrite=True) as part, part.open("wb") as stream:
                for data in log.all_bytes():
                    stream.write(data)
                    advance(len(data))
            log.read_from(_copy_of(log))


def _make_room(kept: Collection[Path], size: int) -> None:
    """Remove the least recently used logs, without those in `kept`, until `size` bytes fit."""
    folder = _folder()
    shutil.rmtree(users_cache() / "chunks", ignore_errors=True)  # of earlier versions
    for part in folder.glob(f"*{PART_SUFFIX}"):  # of killed processes: the lock is held
        part.unlink()
    logs = sorted((path.stat().st_mtime, path.stat().st_size, path) for path in folder.glob("*.mcap"))
    held = sum(log_bytes for _, log_bytes, _ in logs)
    free = shutil.disk_usage(folder).free - _STAYS_FREE
    most = min(_max_bytes(), held + free)
    needed = size + sum(log_bytes for _, log_bytes, path in logs if path in kept)
    if needed > most:
        why = "the disk has no more room" if most < _max_bytes() else "BC_CACHE_GB sets how much"
        raise UserError(
            f"{folder}: {needed / 1e9:,.1f} GB of logs have to be fetched to it, but it can hold"
            f" {max(0, most) / 1e9:,.1f} GB ({why}; BC_CACHE names another folder)"
        )
    for _, log_bytes, path in logs:
        if held + size <= most:
            return
        if path not in kept:
            path.unlink()
            held -= log_bytes


def _max_bytes() -> int:
    given = os.environ.get("BC_CACHE_GB", "")
    try:
        max_gb = float(given) if given else _DEFAULT_GB
    except ValueError:
        max_gb = -1.0
    if not 0 <= max_gb < 1e9:
        raise UsageError(f"BC_CACHE_GB={given}: expected a number of gigabytes")
    return int(max_gb * 1e9)
