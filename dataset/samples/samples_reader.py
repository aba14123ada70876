"""Read the balanced index for training: `index/samples.parquet`, its logs and its rows."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, get_args

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from common.car import MAX_STEERING_DEG
from common.closeable import Closeable
from common.files import short_path
from common.location import Location, Url, local_path
from common.process_settings import allow_open_files
from common.stored_settings import settings_from
from common.tasks import in_threads, one_by_one
from dataset.config import IndexConfig
from dataset.errors import DatasetError
from dataset.frames.frames_file import log_place
from dataset.missing_index import missing_index
from dataset.parquet_file import MAX_METADATA_BYTES, METADATA_KEY, read_schema
from dataset.prediction_targets import STEERING_ONLY, TARGETS, TargetName, speed_ahead_s_in
from dataset.samples.sample_rows import Rows, numbers, rows_of, target_labels, words_as_numbers
from dataset.samples.samples_format import READABLE_FORMATS, SAMPLES_FORMAT, SAMPLES_NAME, SAMPLES_SCHEMA, Balance
from recorder import Log, LogError

Split = Literal["train", "validation"]

LOADED: Final = ("session", "offset", "length", "chunk", "flip", "alteration", "seed", "label", "split")
"""The columns that the loader needs."""

FINGERPRINTED: Final = (*LOADED, "camera", "copy", "recorded")
"""The columns on which training and validation depend."""

_CONTENT: Final = ("row", *(name for name in FINGERPRINTED if name not in ("offset", "chunk")))

_WORDS: Final = ("session", "camera", "alteration", "split")  # few distinct words: read as dictionaries

_UNREADABLE: Final = (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, pa.ArrowException)


class IndexedLog(NamedTuple):
    path: str  # relative to the index
    fingerprint: str  # of the content
    file: str  # fingerprint of the file


class Samples(Closeable):
    """The samples of an index, and the logs with their pictures. Use it as a context manager, or call `close()`.

    Raises DatasetError if the index is missing or damaged, or if a log has changed since it was indexed.
    """

    def __init__(self, index: Path | str) -> None:
        index = local_path(index)
        self.path = index / SAMPLES_NAME
        try:
            self.metadata: dict[str, Any] = json.loads(read_schema(self.path).metadata[METADATA_KEY])
            self.sources = {
                str(session): IndexedLog(
                    str(source["log"]), str(source["fingerprint"]), str(source.get("file", source["fingerprint"]))
                )
                for session, source in self.metadata["logs"].items()
            }
            version = self.metadata["format"]
            has_views = bool((self.metadata.get("settings") or {}).get("viewpoints"))
        except (FileNotFoundError, NotADirectoryError):
            raise missing_index(index) from None
        except _UNREADABLE as error:
            raise self.damaged(error) from None
        if version not in READABLE_FORMATS:
            raise DatasetError(f"{self.path}: has format {version}, not {SAMPLES_FORMAT}; run `bc-index` again")
        if has_views:
            raise DatasetError(f"{self.path}: has viewpoints of an earlier version; run `bc-index` again")
        self.logs = open_logs(index, self.sources)

    def close(self) -> None:
        for log in self.logs.values():
            log.close()

    @cached_property
    def _columns(self) -> list[str]:
        with self._readable():
            return list(read_schema(self.path).names)

    @cached_property
    def table(self) -> pa.Table:
        return self._table(None)

    def of_split(self, split: Split, columns: Sequence[str] | None = None) -> pa.Table:
        """The samples of a split, with all or some columns. The loader needs only `LOADED`, a third of the
        memory."""
        return self._table(columns, split=_checked(split))

    def rows_of_split(self, split: Split, targets: Sequence[TargetName] = STEERING_ONLY) -> Rows:
        labels = (TARGETS[name].label_column for name in targets if name not in STEERING_ONLY)
        return self.rows(self.of_split(split, (*LOADED, *labels)), targets)

    def driving_view(self, split: Split) -> pa.Table:
        """The samples as the car sees them: the centre camera, not mirrored, not altered, each picture once.

        If there are no pictures of the centre camera, those of the others. `label` is the recorded steering: a
        network is always compared with the recorded driving.
        """
        plain: dict[str, Any] = {"split": _checked(split), "flip": False, "copy": False}
        center = self._table(None, **plain, camera="center")
        view = center if len(center) else self._table(None, **plain)
        with self._readable():
            return view.set_column(view.schema.get_field_index("label"), "label", view["recorded"])

    @cached_property
    def settings(self) -> IndexConfig:
        """The settings with which the index was built. Raises DatasetError if they are damaged."""
        try:
            return settings_from(IndexConfig, self.metadata["settings"])
        except (KeyError, ValueError) as error:
            raise self.damaged(error) from None

    @cached_property
    def balance(self) -> Balance:
        with self._readable():
            return Balance.from_dict(self.metadata["balance"])

    @cached_property
    def max_steering_deg(self) -> float | None:
        """The angle of the front wheels at steering 1, in degrees; None if it is unknown in a session. Raises
        DatasetError if the sessions have different angles."""
        with self._readable():
            angles_deg = {log.get("max_steering_deg", MAX_STEERING_DEG) for log in self.metadata["logs"].values()}
        if None in angles_deg:
            return None
        if len(angles_deg) != 1:
            raise self.damaged("its sessions have different angles at steering 1")
        return float(angles_deg.pop())

    @property
    def fingerprint(self) -> str:
        """SHA-256, in hex, of everything that training and validation read: the logs and the places of their
        pictures, flips, alterations, labels, and the split. It does not depend on the folders of the index and the
        logs."""
        return self._fingerprint_of(FINGERPRINTED)

    @property
    def content_fingerprint(self) -> str:
        """Like `fingerprint`, with rows and cameras instead of places in files: equal after a log was
        rewritten."""
        return self._fingerprint_of(_CONTENT)

    def _fingerprint_of(self, columns: Sequence[str]) -> str:
        digests = {name: self._digests[name] for name in columns}
        logs = sorted(log.fingerprint for log in self.sources.values())
        return hashlib.sha256(json.dumps([logs, digests]).encode()).hexdigest()

    @cached_property
    def _digests(self) -> dict[str, str]:
        logs = {session: log.fingerprint for session, log in self.sources.items()}
        digests = {name: hashlib.sha256() for name in dict.fromkeys((*FINGERPRINTED, *_CONTENT))}
        with self._readable():
            for part in self._groups(tuple(digests)):
                for name, digest in digests.items():
                    digest.update(
                        _hashable(part[name], SAMPLES_SCHEMA.field(name).type, logs if name == "session" else {})
                    )
        return {name: digest.hexdigest() for name, digest in digests.items()}

    @property
    def speed_ahead_s(self) -> float:
        """The time in seconds from a picture to the speed that is its label; 0 if the index lacks it."""
        return speed_ahead_s_in(self.metadata.get("settings"))

    def missing(self, targets: Sequence[TargetName]) -> list[TargetName]:
        """The targets for which this index has no labels, because an earlier version built it."""
        return [name for name in targets if TARGETS[name].label_column not in self._columns]

    def refuse_missing(self, targets: Sequence[TargetName]) -> None:
        if missing := self.missing(targets):
            raise DatasetError(
                f"{self.path}: has format {self.metadata['format']}, without labels of {', '.join(missing)};"
                " run `bc-index` again"
            )

    def targets_fingerprint(self, targets: Sequence[TargetName]) -> str:
        """SHA-256, in hex, of the labels of the targets other than steering; "" without other targets."""
        others = [name for name in targets if name not in STEERING_ONLY]
        if not others:
            return ""
        table = self._table([TARGETS[name].label_column for name in others])
        digest = hashlib.sha256()
        for name in others:
            digest.update(self.target_labels(table, name).tobytes())
        return digest.hexdigest()

    def target_labels(self, table: pa.Table, target: TargetName) -> NDArray[np.float64]:
        """The labels (N,) of a target other than steering, in its unit, for samples of this index; NaN if unknown.
        Raises DatasetError for invalid values."""
        with self._readable():
            return target_labels(table, target)

    def rows(self, table: pa.Table, targets: Sequence[TargetName] = STEERING_ONLY) -> Rows:
        """Convert samples of this index to arrays. `table` needs the label columns of the targets. Raises
        DatasetError for invalid values."""
        with self._readable():
            return rows_of(table, self.sources, targets)

    def _table(self, columns: Sequence[str] | None, **values: str | bool) -> pa.Table:
        """The samples that have these values (column=value)."""
        parts = []
        with self._readable():
            for part in self._groups(columns and tuple(dict.fromkeys((*columns, *values)))):
                for name, value in values.items():
                    part = part.filter(pc.equal(part[name], value))
                parts.append(part.select(columns) if columns else part)
            return pa.concat_tables(parts)

    def _groups(self, columns: Sequence[str] | None) -> Iterator[pa.Table]:
        """Yield an empty table, then the samples in row groups. Raises the errors of `_UNREADABLE`.

        It reads row group by row group, because read_table(filters=...) has hung on a damaged file.
        """
        words = _WORDS if columns else ()
        with pq.ParquetFile(
            self.path,
            read_dictionary=words,
            page_checksum_verification=True,
            thrift_string_size_limit=MAX_METADATA_BYTES,
        ) as file:
            yield file.schema_arrow.empty_table().select(columns or file.schema_arrow.names)
            for group in range(file.num_row_groups):
                yield file.read_row_group(group, columns)

    @contextlib.contextmanager
    def _readable(self) -> Iterator[None]:
        """Raise the errors that a damaged file causes in the block as DatasetError."""
        try:
            yield
        except _UNREADABLE as error:
            raise self.damaged(error) from None

    def damaged(self, error: Exception | str) -> DatasetError:
        why = " ".join(str(error).split())
        return DatasetError(f"{self.path}: damaged ({why}); remove it and run `bc-index`")


def open_logs(index: Path, sources: Mapping[str, IndexedLog]) -> dict[str, Log]:
    """Open the logs of an index, by session.

    Raises DatasetError if a log is missing or has changed since it was indexed, and closes the others.
    """
    allow_open_files(len(sources))
    folder_of = cache(short_path)  # cached: it reads each folder of the path from the disk

    logs: dict[str, Log] = {}

    def open_log(session: str, place: Location) -> None:
        if isinstance(place, Path):
            place = folder_of(place.parent) / place.name  # a path that stays valid if the index is temporary
            if not place.is_file():
                raise DatasetError(
                    f"{place}: the log of session {session} is missing; put it back or run `bc-index` again"
                )
        try:
            log = logs[session] = Log(place)
        except (LogError, OSError) as error:
            raise DatasetError(f"{error} (session {session} of the index; `bc-index` leaves it out)") from None
        if log.file_fingerprint != sources[session].file:
            raise DatasetError(
                f"{place}: has changed since it was indexed as session {session}; run `bc-index` again"
            )

    places = [(session, log_place(source.path, index)) for session, source in sources.items()]
    tasks = in_threads if any(isinstance(place, Url) for _, place in places) else one_by_one
    try:
        for _ in tasks(open_log, places):
            pass
    except BaseException:
        for log in logs.values():
            log.close()
        raise
    return {session: logs[session] for session in sources}


def _checked(split: Split) -> str:
    if split not in get_args(Split):
        raise ValueError(f"split is {split!r}; expected {' or '.join(map(repr, get_args(Split)))}")
    return split


def _hashable(column: pa.ChunkedArray, kind: pa.DataType, replacements: Mapping[str, str]) -> bytes:
    """The values of a column as bytes, independent of their encoding in the file. A word becomes its hash, or the
    hash of its replacement."""
    if kind != pa.string():
        return numbers(column, kind.to_pandas_dtype()).tobytes()
    number, words = words_as_numbers(column)
    hashes = [hashlib.sha256(replacements.get(word, word).encode()).digest()[:8] for word in words]
    return np.array(hashes, "V8")[number].tobytes()
