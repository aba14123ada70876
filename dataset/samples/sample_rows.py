"""Samples as arrays: 18 bytes for each sample and 24 bytes for each picture, so that ten million fit in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from dataset.alterations import ALTERATIONS
from dataset.frames.distinct_rows import number_distinct
from dataset.prediction_targets import STEERING_ONLY, TARGETS, TargetName


@dataclass(frozen=True)
class Rows:
    """N samples and their P pictures. An original, its mirror image and copies share a picture."""

    picture: NDArray[np.int32]  # (N,): number of the sample's picture
    flip: NDArray[np.bool_]  # (N,)
    alteration: NDArray[np.uint8]  # (N,): position in `alterations`
    seed: NDArray[np.int64]  # (N,): of the alteration
    label: NDArray[np.float32]  # (N,): steering, -1..1; with other targets (N, K), NaN if a label is unknown
    session: NDArray[np.int32]  # (P,): position in `sessions`
    offset: NDArray[np.int64]  # (P,): offset, length and chunk are arguments of Log.read
    length: NDArray[np.int32]  # (P,)
    chunk: NDArray[np.int64]  # (P,)
    alterations: tuple[str, ...]  # "" or names joined by "+"
    sessions: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.label)


def rows_of(table: pa.Table, sources: Mapping[str, object], targets: Sequence[TargetName] = STEERING_ONLY) -> Rows:
    """Convert a table of samples to arrays. Raises ValueError, TypeError or KeyError for invalid values."""
    session, sessions = words_as_numbers(table["session"])
    alteration, alterations = words_as_numbers(table["alteration"])
    if unknown := set(sessions) - sources.keys():
        raise ValueError(f"session {min(unknown)!r} has no log")
    allowed = {"", *ALTERATIONS}
    if len(alterations) > 255 or any(not allowed.issuperset(names.split("+")) for names in alterations):
        raise ValueError("an unknown alteration")
    offset, length, chunk = (numbers(table[name], np.int64) for name in ("offset", "length", "chunk"))
    seed, label = numbers(table["seed"], np.int64), numbers(table["label"], np.float64)
    if len(table) and (min(length.min(), seed.min()) < 0 or length.max() > 2**31 - 1):
        raise ValueError("a length or a seed out of range")
    if not (np.abs(label) <= 1).all():
        raise ValueError("a label that is not in -1..1")
    picture, first = number_distinct(length, offset, chunk, session)
    return Rows(
        picture,
        numbers(table["flip"], np.bool_),
        alteration.astype(np.uint8),
        seed,
        _labels(table, label, targets),
        session[first],
        offset[first],
        length[first].astype(np.int32),
        chunk[first],
        alterations,
        sessions,
    )


def _labels(table: pa.Table, steering: NDArray[np.float64], targets: Sequence[TargetName]) -> NDArray[np.float32]:
    if len(targets) == 1:
        return steering.astype(np.float32)
    others = (target_labels(table, name) / TARGETS[name].per_unit for name in targets[1:])
    return np.stack([steering, *others], axis=1).astype(np.float32)


def target_labels(table: pa.Table, target: TargetName) -> NDArray[np.float64]:
    """The labels (N,) of a target other than steering, in its unit; NaN if unknown. Raises the errors of
    `rows_of`."""
    column, max_label = TARGETS[target].label_column, TARGETS[target].max_label
    labels = numbers(pc.fill_null(table[column], np.nan), np.float64)
    if (np.abs(labels) > max_label).any():  # False for NaN
        raise ValueError(f"a {column} that is not in -{max_label:g}..{max_label:g}")
    return labels


def words_as_numbers(column: pa.ChunkedArray) -> tuple[NDArray[np.int32], tuple[str, ...]]:
    """Convert a column of words (N,) to numbers (N,). Returns the numbers, and the word of each number."""
    if not pa.types.is_dictionary(column.type):
        column = column.dictionary_encode()
    column = column.unify_dictionaries()
    words = column.chunk(0).dictionary.to_pylist() if column.num_chunks else []
    if not all(isinstance(word, str) for word in words):
        raise TypeError("a column of words has other values")
    parts = [numbers(chunk.indices, np.int32) for chunk in column.chunks]
    return np.concatenate([*parts, np.zeros(0, np.int32)]), tuple(words)


def numbers(column: pa.Array | pa.ChunkedArray, kind: Any) -> NDArray[Any]:
    if column.null_count:
        raise ValueError("a value is missing")
    values: NDArray[Any] = column.to_numpy(zero_copy_only=False)
    return values.astype(kind, casting="same_kind", copy=False)
