"""Results of files that take a while, made one by one on a thread while pages show those that are there."""

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
"""Time after which a store that did not answer is asked again."""


class _Made(NamedTuple, Generic[Result]):
    result: Result | UserError
    at_s: float


class _Task(NamedTuple, Generic[Result]):
    version: str
    future: Future[_Made[Result]]

    def is_of(self, version: str) -> bool:
        """Whether its result is, or will be, that of `version`; where a store did not answer, for a while."""
        if self.version != version:
            return False
        if not self.future.done() or self.future.cancelled():
            return True
        made = self.future.result()
        return not isinstance(made.result, StoreError) or time.monotonic() < made.at_s + AGAIN_S


class Background(Generic[Place, Result]):
    """A result for each file, made anew when its version is another one."""

    def __init__(self, pool: Executor, make: Callable[[Place, str], Result]) -> None:
        """`make` takes a file and its version. An exception is the result, as UserError."""
        self._pool = pool
        self._make = make
        self._lock = threading.Lock()
        self._tasks: dict[Place, _Task[Result]] = {}
        self.done = 0
        """Grows with every result: pages that have not shown it yet ask again."""

    def results(
        self, versions: Iterable[tuple[Place, str]], patience_s: float | None
    ) -> dict[Place, Result | UserError]:
        """The results that are there after `patience_s` at most; None waits for all. Those of other files are
        dropped."""
        with self._lock:
            before, self._tasks = self._tasks, {}
            for path, version in versions:
                known = before.pop(path, None)
                if known is None or not known.is_of(version):
                    if known is not None:
                        known.future.cancel()
                    known = _Task(version, self._pool.submit(self._run, path, version))
                self._tasks[path] = known
            for dropped in before.values():
                dropped.future.cancel()
            futures = {path: task.future for path, task in self._tasks.items()}
        wait(futures.values(), patience_s)
        # a cancelled one is of a version that another request has found replaced
        there = ((path, future) for path, future in futures.items() if future.done() and not future.cancelled())
        return {path: future.result().result for path, future in there}

    def _run(self, path: Place, version: str) -> _Made[Result]:
        result = self._result(path, version)
        with self._lock:
            self.done += 1
        return _Made(result, time.monotonic())

    def _result(self, path: Place, version: str) -> Result | UserError:
        try:
            return self._make(path, version)
        except UserError as error:
            return error
        except OSError as error:  # deleted meanwhile, or not ours to read
            return UserError(f"{path}: {error.strerror or error}")
        except Exception as error:  # a bug: one log must not take the others out of the list
            return UserError(f"{path}: {report_bug(error)}")
