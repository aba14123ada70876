"""Results of files that take a while, made one after the other on a thread while pages show what is there."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future, wait
from pathlib import Path
from typing import Generic, TypeVar

from common import UserError

Result = TypeVar("Result")


class Background(Generic[Result]):
    """A result for each file, made anew when its version is another one."""

    def __init__(self, pool: Executor, make: Callable[[Path, str], Result]) -> None:
        """`make` takes a file and its version. What it raises is the result, as UserError."""
        self._pool = pool
        self._make = make
        self._lock = threading.Lock()
        self._futures: dict[Path, tuple[str, Future[Result | UserError]]] = {}
        self.done = 0
        """Grows with every result: pages that have not shown it yet ask again."""

    def results(self, versions: Iterable[tuple[Path, str]], patience_s: float) -> dict[Path, Result | UserError]:
        """Those that are there after `patience_s` at most. Of files that are not among these, nothing is kept."""
        with self._lock:
            before, self._futures = self._futures, {}
            for path, version in versions:
                known = before.pop(path, None)
                if known is None or known[0] != version:
                    if known is not None:
                        known[1].cancel()
                    known = version, self._pool.submit(self._run, path, version)
                self._futures[path] = known
            for _, gone in before.values():
                gone.cancel()
            futures = {path: future for path, (_, future) in self._futures.items()}
        wait(futures.values(), patience_s)
        # one that was cancelled is of a version that another request has seen replaced
        there = ((path, future) for path, future in futures.items() if future.done() and not future.cancelled())
        return {path: future.result() for path, future in there}

    def _run(self, path: Path, version: str) -> Result | UserError:
        try:
            return self._make(path, version)
        except UserError as error:
            return error
        except OSError as error:  # deleted meanwhile, or not ours to read
            return UserError(f"{path}: {error.strerror or error}")
        except Exception as error:  # a bug: one log must not take the others out of the list
            traceback.print_exception(error)
            return UserError(f"{path}: a bug ({type(error).__name__}); the terminal of bc-web tells more")
        finally:
            with self._lock:
                self.done += 1
