"""Slow results of files, made on threads. Pages show the results that are finished."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future, wait
from typing import Final, Generic, NamedTuple, TypeVar

from common import UserError
from common.errors import StoreError
from common.location import Location
from web.errors import report_bug

Place = TypeVar("Place", bound=Location)
Result = TypeVar("Result")

AGAIN_S: Final = 10.0
"""Time after which a store that did not answer is tried again."""


class _Task(NamedTuple, Generic[Result]):
    version: str
    future: Future[tuple[Result | UserError, float]]  # and the time when it was made

    def is_for(self, version: str) -> bool:
        """Whether the task is for `version`. If a store did not answer, it counts for `AGAIN_S` only."""
        if self.version != version:
            return False
        if not self.future.done() or self.future.cancelled():
            return True
        result, at_s = self.future.result()
        return not isinstance(result, StoreError) or time.monotonic() < at_s + AGAIN_S


class Background(Generic[Place, Result]):
    """A result for each file, made again when the version of the file changes."""

    def __init__(self, pool: Executor, make: Callable[[Place, str], Result]) -> None:
        """`make` takes a file and its version. An exception is the result, as UserError."""
        self._pool = pool
        self._make = make
        self._lock = threading.Lock()
        self._tasks: dict[Place, _Task[Result]] = {}
        self.done = 0
        """The number of results made so far. When it grows, pages load their lists again."""

    def results(
        self, versions: Iterable[tuple[Place, str]], patience_s: float | None
    ) -> dict[Place, Result | UserError]:
        """The results that are finished within `patience_s`; None waits for all. Results of other files are
        dropped."""
        with self._lock:
            before, self._tasks = self._tasks, {}
            for path, version in versions:
                task = before.pop(path, None)
                if task is None or not task.is_for(version):
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
        return {path: future.result()[0] for path, future in finished}

    def _run(self, path: Place, version: str) -> tuple[Result | UserError, float]:
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
        return result, time.monotonic()
