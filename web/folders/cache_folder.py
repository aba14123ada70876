"""Slow results of files, made on threads, and kept in the user's cache folder. It may be deleted at any time."""

from __future__ import annotations

import contextlib
import hashlib
import secrets
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future, wait
from pathlib import Path
from typing import Final, Generic, NamedTuple, TypeVar

import msgspec

from common import UserError
from common.untrusted import json_as
from common.users_cache import users_cache
from web.errors import report_bug

Result = TypeVar("Result")


PATIENCE_S: Final = 0.5
"""Time for files that are being read: enough for a few. Pages complete a longer list later."""


class _Task(NamedTuple, Generic[Result]):
    version: str
    future: Future[Result | UserError]


class Background(Generic[Result]):
    """A result for each file, made again when the version of the file changes."""

    def __init__(self, pool: Executor, make: Callable[[Path, str], Result]) -> None:
        """`make` takes a file and its version. An exception is the result, as UserError."""
        self._pool = pool
        self._make = make
        self._lock = threading.Lock()
        self._tasks: dict[Path, _Task[Result]] = {}
        self.done = 0
        """The number of results made so far. When it grows, pages load their lists again."""

    def results(
        self, versions: Iterable[tuple[Path, str]], patience_s: float | None = PATIENCE_S
    ) -> dict[Path, Result | UserError]:
        """The results that are finished within `patience_s`; None waits for all. Results of other files are
        dropped."""
        with self._lock:
            before, self._tasks = self._tasks, {}
            for path, version in versions:
                task = before.pop(path, None)
                if task is None or task.version != version:
                    if task is not None:
                        task.future.cancel()
                    task = _Task(version, self._pool.submit(self._run, path, version))
                self._tasks[path] = task
            for dropped in before.values():
                dropped.future.cancel()
            futures = {path: task.future for path, task in self._tasks.items()}
        wait(futures.values(), patience_s)
        # another request cancels a task if it finds a newer version
        finished = ((path, future) for path, future in futures.items() if future.done() and not future.cancelled())
        return {path: future.result() for path, future in finished}

    def _run(self, path: Path, version: str) -> Result | UserError:
        result: Result | UserError
        try:
            result = self._make(path, version)
        except UserError as error:
            result = error
        except OSError as error:  # deleted meanwhile, or not readable
            result = UserError(f"{path}: {error.strerror or error}")
        except Exception as error:  # a bug must not hide the other logs
            result = UserError(f"{path}: {report_bug(error)}")
        with self._lock:
            self.done += 1
        return result


Kept = TypeVar("Kept")

_MAX_BYTES: Final = 512 << 20


def default_cache_folder() -> Path:
    return users_cache() / "web"


class CacheFolder:
    """Bytes by key. If a file cannot be read or written, its data are made again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        with contextlib.suppress(OSError):  # read-only
            folder.mkdir(parents=True, exist_ok=True)
            folder.chmod(0o700)  # pictures of logs, and what jobs printed, are not for other users

    def get(self, key: str, make: Callable[[], bytes]) -> bytes:
        """The data of a key. If there are none, call `make` and keep what it returns."""
        if data := self.find(key):
            return data
        data = make()
        self.keep(key, data)
        return data

    def struct(self, key: str, kind: type[Kept], make: Callable[[], Kept]) -> Kept:
        """`get` for a value that msgspec encodes. If the file is damaged, make it again."""
        value = json_as(self.find(key) or b"", kind)
        if value is None:
            value = make()
            self.keep(key, msgspec.json.encode(value))
        return value

    def find(self, key: str) -> bytes | None:
        try:
            return self._path(key).read_bytes() or None
        except OSError:
            return None

    def tidy(self) -> None:
        """Remove the oldest files beyond half a gigabyte."""
        files = []
        with contextlib.suppress(OSError):
            for path in self.folder.glob("*/*"):
                status = path.stat()
                files.append((status.st_mtime_ns, status.st_size, path))
        files.sort(reverse=True)
        total = 0
        for _, size, path in files:
            total += size
            if total > _MAX_BYTES:
                with contextlib.suppress(OSError):
                    path.unlink()

    def keep(self, key: str, data: bytes) -> None:
        path = self._path(key)
        part = path.with_name(f"{path.name}.{secrets.token_hex(3)}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(data)
            part.replace(path)  # no fsync: what a power cut destroys is made again
        except OSError:  # the disk is full or read-only: the data are made each time
            with contextlib.suppress(OSError):
                part.unlink()

    def _path(self, key: str) -> Path:
        name = hashlib.sha256(key.encode("utf-8", "surrogateescape")).hexdigest()
        return self.folder / name[:2] / name[2:]
