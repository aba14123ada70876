"""The balanced index as training reads it: `index/samples.parquet`, the logs that it points into, and its rows.

The rows are arrays, not Python objects: 18 bytes a sample and 24 bytes a picture, so that ten million fit.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal, get_args

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from common.open_file_limit import allow_open_files
from dataset.augment import ALTERATIONS
from dataset.errors import DatasetError
from dataset.index.samples_format import FORMAT, METADATA_KEY, SAMPLES_NAME, SCHEMA
from recorder import Log, LogError

Split = Literal["train", "validation"]

LOADED: Final = ("session", "offset", "length", "chunk", "flip", "alteration", "seed", "label", "split")
"""The columns that a loader needs."""

FINGERPRINTED: Final = (*LOADED, "camera", "copy", "recorded")
"""The columns that training and validation depend on."""

_WORDS: Final = ("session", "camera", "alteration", "split")  # of those, few different ones: read as numbers
_UNREADABLE: Final = (
    OSError,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    OverflowError,
    RecursionError,
    pa.ArrowException,
)


@dataclass(frozen=True)
class Rows:
    """Samples, and the pictures that they show. Mirror images and copies show the same picture."""

    picture: NDArray[np.int32]  # of each sample: which of the pictures
    flip: NDArray[np.bool_]
    alteration: NDArray[np.uint8]  # which of `alterations`
    seed: NDArray[np.int64]  # of the alteration
    label: NDArray[np.float32]  # steering, -1..1
    session: NDArray[np.int32]  # of each picture: which of `sessions`
    offset: NDArray[np.int64]  # of each picture: for Log.read, as the next two
    length: NDArray[np.int32]
    chunk: NDArray[np.int64]
    alterations: tuple[str, ...]  # "" or names joined by "+"
    sessions: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.label)


class Samples:
    """The samples of one index, and the logs that hold their pictures. Use it as one does a file: close it.

    Raises DatasetError if there is no index, if it is damaged, or if a log is not the one that was indexed.
    """

    def __init__(self, index: Path | str) -> None:
        index = Path(index)
        self.path = index / SAMPLES_NAME
        try:
            self.metadata: dict[str, Any] = json.loads(pq.read_schema(self.path).metadata[METADATA_KEY])
            self.sources = {
                str(session): (str(source["log"]), str(source["fingerprint"]))
                for session, source in self.metadata["logs"].items()
            }
            version = self.metadata["format"]
        except FileNotFoundError:
            raise DatasetError(f"{self.path}: no index; build it with `bc-index`") from None
        except _UNREADABLE as error:
            raise self._damaged(error) from None
        if version != FORMAT:
            raise DatasetError(f"{self.path}: of format {version}, not {FORMAT}; run `bc-index` again")
        self.logs = open_logs(index, self.sources)

    def close(self) -> None:
        for log in self.logs.values():
            log.close()

    @cached_property
    def table(self) -> pa.Table:
        """All samples with all columns, as they are in the file."""
        return self._table(None)

    def of_split(self, split: Split, columns: Sequence[str] | None = None) -> pa.Table:
        """The samples of a split; `LOADED` are the columns that a loader needs, in a third of the memory."""
        return self._table(columns, split=_known(split))

    def driving_view(self, split: Split) -> pa.Table:
        """What the car itself sees: the centre camera, unmirrored and unaltered, each picture once.

        Without pictures of the centre camera, those of the others. `label` is as recorded, whatever was learnt:
        a network is always measured against what was driven.
        """
        plain: dict[str, Any] = {"split": _known(split), "flip": False, "copy": False}
        center = self._table(None, **plain, camera="center")
        seen = center if len(center) else self._table(None, **plain)
        try:
            return seen.set_column(seen.schema.get_field_index("label"), "label", seen["recorded"])
        except _UNREADABLE as error:
            raise self._damaged(error) from None

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256, in hex, of all that training and validation read: which bytes of which logs, how they are
        mirrored and altered, labels, and the split. It does not depend on where the index and its logs lie.
        """
        logs = {session: fingerprint for session, (_, fingerprint) in self.sources.items()}
        digests = {name: hashlib.sha256() for name in FINGERPRINTED}
        try:
            for part in self._groups(FINGERPRINTED):
                for name, digest in digests.items():
                    digest.update(
                        _hashable(part[name], SCHEMA.field(name).type, logs if name == "session" else {})
                    )
        except _UNREADABLE as error:
            raise self._damaged(error) from None
        told = [sorted(logs.values()), {name: digest.hexdigest() for name, digest in digests.items()}]
        return hashlib.sha256(json.dumps(told).encode()).hexdigest()

    def rows(self, table: pa.Table) -> Rows:
        """Samples of this index as arrays. Raises DatasetError for what no index holds."""
        try:
            return _rows(table, self.sources)
        except _UNREADABLE as error:
            raise self._damaged(error) from None

    def _table(self, columns: Sequence[str] | None, **values: str | bool) -> pa.Table:
        """The rows of which these columns have these values."""
        parts = []
        try:
            for part in self._groups(columns):
                for name, value in values.items():
                    part = part.filter(pc.equal(part[name], value))
                parts.append(part)
            return pa.concat_tables(parts)
        except _UNREADABLE as error:
            raise self._damaged(error) from None

    def _groups(self, columns: Sequence[str] | None) -> Iterator[pa.Table]:
        """The file part by part, the first one empty. Raises what is `_UNREADABLE`.

        Row group by row group: read_table(filters=...) was seen to wait forever on a damaged file.
        """
        words = _WORDS if columns else ()
        with pq.ParquetFile(self.path, read_dictionary=words, page_checksum_verification=True) as file:
            yield file.schema_arrow.empty_table().select(columns or file.schema_arrow.names)
            for group in range(file.num_row_groups):
                yield file.read_row_group(group, columns)

    def _damaged(self, error: Exception) -> DatasetError:
        why = " ".join(str(error).split())
        return DatasetError(f"{self.path}: damaged ({why}); remove it and give `bc-index`")


def open_logs(index: Path, sources: Mapping[str, tuple[str, str]]) -> dict[str, Log]:
    """The logs of an index by session; `sources` tells of each its path from the index and its fingerprint.

    Raises DatasetError for a log that is not the one that was indexed; none is left open then.
    """
    allow_open_files(len(sources))
    logs: dict[str, Log] = {}
    try:
        for session, (place, fingerprint) in sources.items():
            path = index / place
            if not path.is_file():
                raise DatasetError(
                    f"{path}: the log of session {session} is gone; put it back or run `bc-index` again"
                )
            log = logs[session] = Log(path)
            if log.fingerprint != fingerprint:
                raise DatasetError(
                    f"{path}: has changed since it was indexed as session {session}; run `bc-index` again"
                )
    except BaseException as error:
        for log in logs.values():
            log.close()
        if isinstance(error, LogError | OSError):
            raise DatasetError(f"{error} (session {session} of the index; without it: `bc-index`)") from None
        raise
    return logs


def _known(split: Split) -> str:
    if split not in get_args(Split):
        raise ValueError(f"split is {split!r}; there are {' and '.join(map(repr, get_args(Split)))}")
    return split


def _rows(table: pa.Table, sources: Mapping[str, object]) -> Rows:
    """Raises ValueError, TypeError or KeyError for values that do not make sense."""
    session, sessions = _codes(table["session"])
    alteration, alterations = _codes(table["alteration"])
    if unknown := set(sessions) - sources.keys():
        raise ValueError(f"its session {min(unknown)!r} has no log")
    known = {"", *ALTERATIONS}
    if len(alterations) > 255 or any(not known.issuperset(names.split("+")) for names in alterations):
        raise ValueError("an unknown alteration")
    offset, length, chunk = (_numbers(table[name], np.int64) for name in ("offset", "length", "chunk"))
    seed, label = _numbers(table["seed"], np.int64), _numbers(table["label"], np.float64)
    if len(table) and (min(length.min(), seed.min()) < 0 or length.max() > 2**31 - 1):
        raise ValueError("a length or a seed out of range")
    if not (np.abs(label) <= 1).all():
        raise ValueError("a label that is not in -1..1")
    picture, first = _distinct(length, offset, chunk, session)
    return Rows(
        picture,
        _numbers(table["flip"], np.bool_),
        alteration.astype(np.uint8),
        seed,
        label.astype(np.float32),
        session[first],
        offset[first],
        length[first].astype(np.int32),
        chunk[first],
        alterations,
        sessions,
    )


def _hashable(column: pa.ChunkedArray, kind: pa.DataType, stands_for: Mapping[str, str]) -> bytes:
    """The values of a column as bytes, the same however the file stores them; those of a word are the hash of
    itself, or of what it stands for."""
    if kind != pa.string():
        return _numbers(column, kind.to_pandas_dtype()).tobytes()
    number, words = _codes(column)
    hashes = [hashlib.sha256(stands_for.get(word, word).encode()).digest()[:8] for word in words]
    return np.array(hashes, "V8")[number].tobytes()


def _distinct(*columns: NDArray[Any]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Number the different rows of some columns, sorted by the last: (each row's number, where a number is met).

    The samples of one picture mostly follow one another, so that only few of the rows have to be sorted.
    """
    count = len(columns[0])
    if not count:
        return np.zeros(0, np.int32), np.zeros(0, np.int64)
    head = _changes(columns)
    heads = np.flatnonzero(head)
    order = np.lexsort([column[heads] for column in columns])
    ranked = heads[order]
    is_new = _changes([column[ranked] for column in columns])
    number = np.empty(len(heads), np.int32)
    number[order] = np.cumsum(is_new, dtype=np.int32) - 1
    return np.repeat(number, np.diff(np.append(heads, count))), ranked[is_new]


def _changes(columns: Any) -> NDArray[np.bool_]:
    """Where a row differs from the one before it; the first does."""
    change = np.ones(len(columns[0]), np.bool_)
    change[1:] = False
    for column in columns:
        change[1:] |= column[1:] != column[:-1]
    return change


def _codes(column: pa.ChunkedArray) -> tuple[NDArray[np.int32], tuple[str, ...]]:
    """A column of words as numbers, and the words that they stand for."""
    if not pa.types.is_dictionary(column.type):
        column = column.dictionary_encode()
    column = column.unify_dictionaries()
    words = column.chunk(0).dictionary.to_pylist() if column.num_chunks else []
    if not all(isinstance(word, str) for word in words):
        raise TypeError("a column of words has other values")
    parts = [_numbers(chunk.indices, np.int32) for chunk in column.chunks]
    return np.concatenate([*parts, np.zeros(0, np.int32)]), tuple(words)


def _numbers(column: pa.Array | pa.ChunkedArray, kind: Any) -> NDArray[Any]:
    if column.null_count:
        raise ValueError("a value is missing")
    values: NDArray[Any] = column.to_numpy(zero_copy_only=False)
    return values.astype(kind, casting="same_kind", copy=False)
