"""Slow results of files, made on threads. Pages show the results that are finished."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future, wait
from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

from common import UserError
from web.errors import report_bug

Result = TypeVar("Result")


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
        self, versions: Iterable[tuple[Path, str]], patience_s: float | None
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
