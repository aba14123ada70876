"""`.store.json`, in a store's folder and in its local copies: the object from which each file was copied.

This module does not import obstore, which a command that only reads the local copy does not need.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

import msgspec

from common.files import atomic_file
from common.untrusted import json_as, read_bounded
from common.users_cache import users_cache

RECORD_NAME: Final = ".store.json"
MAX_RECORD_BYTES: Final = 1 << 28


class Copy(msgspec.Struct, frozen=True):
    """A file, and the version of the object with the same content."""

    size: int  # bytes
    mtime_ns: int  # of the file; all copies have the same
    e_tag: str
    version: str | None = None
    sha256: str = ""  # of the content; earlier versions of the toolkit did not write it


class StoreRecord(msgspec.Struct, frozen=True):
    url: str = ""
    files: dict[str, Copy] = {}
    left: dict[str, Copy] = {}
    """The files that this copy lacks, or has in another version than the store."""
    record_version: str = msgspec.field(default="", name="told_by")
    """The version of the store's own record when this copy last read it."""


def read_record(folder: Path) -> StoreRecord:
    """The record of a local folder; an empty record if the folder is not a copy, or the record is too large."""
    try:
        return record_of(read_bounded(folder / RECORD_NAME, MAX_RECORD_BYTES))
    except OSError:
        return StoreRecord()


def cached_from(folder: Path) -> str:
    """The URL from which a folder in the user's cache was copied; "" for any other folder."""
    is_cached = folder.absolute().is_relative_to(users_cache().absolute())
    return read_record(folder).url if is_cached else ""


def record_of(stored: bytes) -> StoreRecord:
    """Parse a record. Returns an empty record if it is invalid or refers to files outside the folder: then all
    files are copied again."""
    record = json_as(stored, StoreRecord)
    return record if record and all(map(is_within, (*record.files, *record.left))) else StoreRecord()


def is_within(name: str) -> bool:
    """True if a relative path with slashes stays within its folder on every operating system."""
    return not any(part in ("", ".", "..") or "\\" in part or ":" in part for part in name.split("/"))


def write_record(folder: Path, record: StoreRecord) -> None:
    with atomic_file(folder / RECORD_NAME, overwrite=True) as part:
        part.write_bytes(bytes_of(record))


def bytes_of(record: StoreRecord) -> bytes:
    return (json.dumps(msgspec.to_builtins(record), indent=1, sort_keys=True) + "\n").encode()
