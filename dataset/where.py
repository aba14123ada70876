"""Choosing frames by a condition in SQL, which DuckDB evaluates."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common import UserError
from dataset.errors import DatasetError

# The condition is code, even if from the user's own command line: it gets no files, no network, no settings.
_CLOSED: dict[str, str | bool | int | float | list[str]] = {
    "enable_external_access": "false",
    "python_enable_replacements": "false",
    "lock_configuration": "true",
}


_NUMBER = "position_in_session"


class Condition:
    """A condition on the columns of the frames, such as "speed_mph > 5 and 'recovery' in tags"."""

    def __init__(self, where: str) -> None:
        """Raises UserError if DuckDB is not installed."""
        try:
            import duckdb  # an extra: only --where needs it
        except ImportError:
            raise UserError(
                '--where needs DuckDB: `pip install "behavioural-cloning-toolkit[where]"` brings it'
            ) from None
        self._where = where
        self._error: type[Exception] = duckdb.Error
        self._connection = duckdb.connect(config=_CLOSED)

    def holds(self, frames: pa.Table) -> NDArray[np.bool_]:
        """For which rows of `frames` (N,) it is true. Raises DatasetError if it is no condition on them."""
        numbered = frames.append_column(_NUMBER, pa.array(np.arange(len(frames))))
        try:
            # a filter takes one expression: no second statement, no ORDER BY or UNION behind it
            chosen = self._connection.from_arrow(numbered).filter(self._where).project(_NUMBER)
            found, again = (np.sort(chosen.fetchnumpy()[_NUMBER]) for _ in range(2))
        except (self._error, KeyError) as error:
            what = str(error).splitlines()[0]
            columns = ", ".join(frames.column_names)
            raise DatasetError(f"--where {self._where!r}: {what}; the columns are {columns}") from None
        if not np.array_equal(found, again):
            raise DatasetError(f"--where {self._where!r}: depends on chance, so that no index could be made again")
        mask = np.zeros(len(frames), np.bool_)
        mask[found] = True
        return mask
