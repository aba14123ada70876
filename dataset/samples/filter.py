"""Choose frames by an SQL condition, which DuckDB evaluates."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common import UserError
from common.versions import install_line
from dataset.errors import DatasetError
from dataset.frames.frames_file import FRAMES_SCHEMA

if TYPE_CHECKING:
    from duckdb import DuckDBPyRelation

# The condition is code, also if it comes from the user's command line: it gets no access to files, the network and
# DuckDB's settings.
_CLOSED: dict[str, str | bool | int | float | list[str]] = {
    "enable_external_access": "false",
    "python_enable_replacements": "false",
    "lock_configuration": "true",
}

_NUMBER: Final = "position_in_session"
_PATIENCE_S: Final = 0.1  # on Windows, Python handles Ctrl-C only between two waits

Answer = TypeVar("Answer")


class Condition:
    """A condition on the columns of the frames, such as "speed_mph > 5 and 'recovery' in tags"."""

    def __init__(self, where: str, max_s: float = math.inf) -> None:
        """`max_s`: the longest time for an evaluation. Raises UserError if DuckDB is not installed."""
        try:
            import duckdb  # an optional package: only --where needs it
        except ImportError:
            raise UserError(f"--where needs DuckDB: run `{install_line('where')}`") from None
        self._where = where
        self._max_s = max_s
        self._error: type[Exception] = duckdb.Error
        self._connection = duckdb.connect(config=_CLOSED)

    def check(self) -> None:
        """Raise DatasetError if this is not a condition on the columns of frames; it is not evaluated."""
        self._answered(FRAMES_SCHEMA.empty_table(), lambda chosen: None)

    def holds(self, frames: pa.Table) -> NDArray[np.bool_]:
        """A mask (N,) of the rows of `frames` that meet the condition. Raises DatasetError if this is not a
        condition on their columns, or takes too long."""
        rows, again = self._answered(
            frames, lambda chosen: [np.sort(chosen.fetchnumpy()[_NUMBER]) for _ in range(2)]
        )
        if not np.array_equal(rows, again):
            raise DatasetError(
                f"--where {self._where!r}: chooses different rows each time, so the index could not be built again"
            )
        mask = np.zeros(len(frames), np.bool_)
        mask[rows] = True
        return mask

    def _answered(self, frames: pa.Table, read: Callable[[DuckDBPyRelation], Answer]) -> Answer:
        """The result of `read` for the numbers of the rows that meet the condition."""
        numbered = frames.append_column(_NUMBER, pa.array(np.arange(len(frames))))

        def query() -> Answer:
            # `filter` accepts a single expression: no second statement, no ORDER BY or UNION after it
            return read(self._connection.from_arrow(numbered).filter(self._where).project(_NUMBER))

        try:
            return self._interruptible(query)
        except (self._error, KeyError) as error:
            why = str(error).splitlines()[0]
            columns = ", ".join(frames.column_names)
            raise DatasetError(f"--where {self._where!r}: {why}; the columns are {columns}") from None

    def _interruptible(self, query: Callable[[], Answer]) -> Answer:
        """Run a query in a thread, so that Ctrl-C ends it with KeyboardInterrupt: in the main thread, DuckDB
        handles signals itself, and an exception of Python's handler is replaced or lost."""
        with ThreadPoolExecutor(1) as pool:
            pending = pool.submit(query)
            end_s = time.monotonic() + self._max_s
            try:
                while not pending.done() and time.monotonic() < end_s:
                    wait([pending], _PATIENCE_S)
                if not pending.done():
                    raise DatasetError(f"--where {self._where!r}: takes longer than {self._max_s:g} s")
            finally:
                while not pending.done():  # repeated, because the query may not have begun at the first interrupt
                    self._connection.interrupt()
                    wait([pending], _PATIENCE_S)
            return pending.result()
