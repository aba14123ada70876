"""Files of divided samples: those of an index in a store come here once, however often they are read."""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from common.errors import UserError
from common.location import Location, Url
from common.users_cache import users_cache
from dataset.errors import DatasetError, index_write_errors
from dataset.parquet_file import METADATA_KEY
from dataset.samples.samples_format import SAMPLES_NAME, Division


def part_files_here(parts: Division, index: Location) -> list[Path]:
    """The files of divided samples, in their order; those of an index in a store are copies in the user's cache,
    which holds the newest ones that were read of each index.

    Raises DatasetError where they are gone, or cannot be kept here; StoreError.
    """
    folder = parts.folder(index)
    local = _brought(folder) if isinstance(folder, Url) else folder
    files = [local / f"{session}.parquet" for session in parts.sessions]
    if missing := next((file for file in files if not file.is_file()), None):
        raise DatasetError(
            f"{folder}: {missing.name} is not there, which {SAMPLES_NAME} names; give the command again if"
            " somebody has just indexed, else `bc-index`"
        )
    return files


def read_part(file: Path, parts: Division, columns: Sequence[str] | None, words: Sequence[str]) -> pa.Table:
    """Columns of a file of divided samples, those named by `words` as dictionaries.

    Raises ValueError for a file of other samples; OSError, KeyError, TypeError or ArrowException for one that
    cannot be read.
    """
    with pq.ParquetFile(file, read_dictionary=words, page_checksum_verification=True) as opened:
        if json.loads(opened.schema_arrow.metadata[METADATA_KEY])["digest"] != parts.digest:
            raise ValueError(f"{file} is not of it")
        return pa.concat_tables(opened.read_row_group(group, columns) for group in range(opened.num_row_groups))


def _brought(folder: Url) -> Path:
    from common.stored_folder import StoredFolder  # an extra

    kept = users_cache() / "samples" / hashlib.sha256(str(folder.parent).encode()).hexdigest()[:12]
    with index_write_errors(kept), StoredFolder(folder, kept / folder.name, waits=True) as copy:
        copy.bring()
        for other in kept.iterdir():  # of earlier indexes, unless somebody is bringing it
            if other != copy.here:
                with contextlib.suppress(UserError), StoredFolder(folder.with_name(other.name), other):
                    shutil.rmtree(other, ignore_errors=True)
        return copy.here
