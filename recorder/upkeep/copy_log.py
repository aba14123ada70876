"""Copies logs between this machine and a store, whole or not at all. Fingerprints are compared, and nothing is
replaced unasked.

To a store: the log is sent in parts, which become an object after the last one. A stopped upload begins again.
From a store: NAME.mcap.XXXXXX.part grows on the disk. Its name depends on the object's ETag, so that a stopped
copy continues. All its CRCs are checked before it gets its name.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from common import UserError
from common.errors import ObjectChangedError, ObjectExistsError, StoreError
from common.files import PART_SUFFIX, atomic_file, make_folder, publish, refuse_existing
from common.interrupts import uninterrupted
from common.location import Location, Url
from common.locks import try_lock
from common.object_file import MAX_READ_AHEAD, ObjectFile
from common.object_store import (
    OnBytes,
    find_object,
    put_new,
    put_over,
    put_parts,
    read_object,
    remove,
)
from recorder.errors import LogError, recovery
from recorder.log.known_lag import copy_lag
from recorder.log.reader import Log
from recorder.log.tags import MAX_BYTES, tags_path
from recorder.upkeep.check import is_whole


@dataclass(frozen=True)
class Copied:
    place: Location
    size: int  # bytes
    is_new: bool  # False: the same log was there already
    notice: str = ""  # about tags that were not copied


def copy_log(
    log: Location,
    to: Location,
    *,
    overwrite: bool = False,
    on_bytes: OnBytes = lambda more: None,
) -> Copied:
    """Copy a finished log, its tags and its lag between this machine and a store, unless it is there already.

    Raises LogError for a log that is unfinished or damaged; a download is kept for a recovery. Raises UserError if
    the name is taken (unless `overwrite`), or both places are of one kind; StoreError.
    """
    if isinstance(log, Path) and isinstance(to, Url):
        copied = _upload(log, to, overwrite, on_bytes)
    elif isinstance(log, Url) and isinstance(to, Path):
        copied = _download(log, to, overwrite, on_bytes)
    elif isinstance(log, Url):
        raise UserError(f"{log} and {to}: both in a store; copy it to this machine first")
    else:
        raise UserError(f"{log} and {to}: both are on this machine; copy with `cp`")
    copy_lag(log, to)
    return copied


def _upload(log: Path, url: Url, overwrite: bool, on_bytes: OnBytes) -> Copied:
    with Log(log) as opened:
        size, fingerprint = opened.size, opened.file_fingerprint
    if (stored := find_object(url)) is not None:
        if stored.size == size and _fingerprint(url) == fingerprint:
            on_bytes(size)
            return Copied(url, size, False, _upload_tags(log, url, overwrite))
        if not overwrite:
            raise ObjectExistsError(f"{url} exists already: choose another name, or give --force to replace it")
    if not is_whole(log):
        raise LogError(f"{log}: unfinished or damaged; run {recovery(log)} first")
    _put(log, url, size, fingerprint, on_bytes)
    return Copied(url, size, True, _upload_tags(log, url, overwrite))


def _put(log: Path, url: Url, size: int, fingerprint: str, on_bytes: OnBytes) -> None:
    try:
        put_parts(url, _parts(log, on_bytes), size)
    except StoreError:  # the object is complete if only the answer was lost, or if another machine has sent it
        if not _is_there(url, size, fingerprint):
            raise
    if _fingerprint(url) != fingerprint:
        remove(url)
        raise LogError(f"{log}: has changed while it was copied; give the command again")


def _is_there(url: Url, size: int, fingerprint: str) -> bool:
    """True if the complete log is at `url`."""
    stored = find_object(url)
    return stored is not None and stored.size == size and _fingerprint(url) == fingerprint


def _parts(log: Path, on_bytes: OnBytes) -> Iterator[bytes]:
    with log.open("rb") as stream:
        while data := stream.read(MAX_READ_AHEAD):
            yield data
            on_bytes(len(data))


def _download(url: Url, path: Path, overwrite: bool, on_bytes: OnBytes) -> Copied:
    with Log(url) as opened:
        fingerprint = opened.file_fingerprint
    with ObjectFile(url) as source:
        if path.is_file() and path.stat().st_size == source.size and _fingerprint(path) == fingerprint:
            on_bytes(source.size)
            return Copied(path, source.size, False, _download_tags(url, path, overwrite))
        refuse_existing(path, overwrite)
        make_folder(path.parent)
        token = hashlib.sha256(f"{url} {source.e_tag} {source.size}".encode()).hexdigest()[:6]
        part = path.with_name(f"{path.name}.{token}{PART_SUFFIX}")
        try:
            with part.open("ab") as stream:
                if not try_lock(stream):
                    raise UserError(f"{part}: is being written by another copy")
                begun = min(stream.tell(), source.size)
                stream.truncate(begun)
                on_bytes(begun)
                for data in source.read_from(begun):
                    stream.write(data)
                    on_bytes(len(data))
        except ObjectChangedError:  # this part cannot be continued
            part.unlink()
            raise
        if not is_whole(part) or _fingerprint(part) != fingerprint:
            raise LogError(f"{url}: unfinished or damaged; {recovery(part)} makes a log of what came")
        with uninterrupted():
            publish(part, path, overwrite)
    return Copied(path, source.size, True, _download_tags(url, path, overwrite))


def _fingerprint(place: Location) -> str:
    with Log(place) as log:
        return log.file_fingerprint


def _upload_tags(log: Path, url: Url, overwrite: bool) -> str:
    """Copy a log's tags; returns the reason if they are not copied."""
    file, stored = tags_path(log), tags_path(url)
    if not file.is_file():
        return ""
    tags = file.read_bytes()
    try:
        (put_over if overwrite else put_new)(stored, tags)
    except ObjectExistsError:
        if read_object(stored, MAX_BYTES) != tags:
            return _other_tags(file, stored)
    return ""


def _download_tags(url: Url, path: Path, overwrite: bool) -> str:
    stored, file = tags_path(url), tags_path(path)
    tags = read_object(stored, MAX_BYTES)
    if tags is None or (file.is_file() and file.read_bytes() == tags):
        return ""
    if file.exists() and not overwrite:
        return _other_tags(stored, file)
    with atomic_file(file, overwrite=overwrite) as part:
        part.write_bytes(tags)
    return ""


def _other_tags(tags: Location, target: Location) -> str:
    return f"{tags}: not copied, {target} has other tags; --force replaces them"
