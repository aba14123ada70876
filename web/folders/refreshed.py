"""Values that take a while to get, such as the listing of a store: refreshed on threads, at most once every few
seconds, however many pages need them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Final, Generic, TypeVar

from common import UserError
from common.errors import printable
from common.interrupts import leave_signals_to_main_thread
from web.errors import report_bug

Value = TypeVar("Value")

EVERY_S: Final = 3.0
"""The least time between two refreshes."""
_BREAK: Final = 10  # times as long as it has taken: stores charge for each thousand names listed
_PATIENCE_S: Final = 1.5


class Refreshed(Generic[Value]):
    """The last value. Reading it does not wait; only the first calls of `refresh` wait a little for it."""

    def __init__(self, name: str, make: Callable[[Value | None], Value]) -> None:
        """`name` is that of the value in messages. `make` is called with the value before."""
        self._make = make
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._next_s = self._first_s = 0.0
        self._has_result = threading.Event()
        self.value: Value | None = None
        """None until the first refresh has ended."""
        self.problem = f"{name}: the store has not answered yet"
        """Why there is no newer value; empty if there is."""

    def refresh(self) -> None:
        """Begin a refresh, if the last one is long enough ago."""
        now_s = time.monotonic()
        with self._lock:
            self._first_s = self._first_s or now_s
            if self._thread is None and now_s >= self._next_s:
                # not one of a pool: the process ends without it
                self._thread = threading.Thread(target=self._run, name="asking a store", daemon=True)
                self._thread.start()
        self._has_result.wait(max(0.0, self._first_s + _PATIENCE_S - now_s))

    def _run(self) -> None:
        leave_signals_to_main_thread()
        began_s = time.monotonic()
        value, problem = self.value, ""
        try:
            value = self._make(value)
        except UserError as error:
            problem = printable(str(error))
        except OSError as error:
            problem = printable(f"{error.filename}: {error.strerror}")
        except Exception as error:
            problem = report_bug(error)
        now_s = time.monotonic()
        with self._lock:
            self.value, self.problem = value, problem
            self._next_s = now_s + max(EVERY_S, 0 if problem else _BREAK * (now_s - began_s))
            self._thread = None
        self._has_result.set()
